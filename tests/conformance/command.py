"""``dcp-conformance`` in this process, and what it printed."""

from __future__ import annotations

from typing import NamedTuple

import pytest
from dcp_conformance.cli import main


class Result(NamedTuple):
    status: int
    out: str
    err: str


class Command:
    """Calls the command, which never ends with a traceback."""

    def __init__(self, capsys: pytest.CaptureFixture[str]) -> None:
        self._capsys = capsys

    def __call__(self, *args: object) -> Result:
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(arg) for arg in args])
        captured = self._capsys.readouterr()
        assert "Traceback" not in captured.err + captured.out
        return Result(int(stop.value.code or 0), captured.out, captured.err)
