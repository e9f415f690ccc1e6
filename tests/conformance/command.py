"""A command in this process, and what it printed."""

from __future__ import annotations

from typing import NamedTuple

import pytest

from dcp_codec.common.commandline import CommandLine


class Result(NamedTuple):
    status: int
    out: str
    err: str


class Command:
    """Calls the command, which never ends with a traceback."""

    def __init__(self, capsys: pytest.CaptureFixture[str], main: CommandLine) -> None:
        self._capsys = capsys
        self._main = main

    def __call__(self, *args: object) -> Result:
        self._capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            self._main([str(arg) for arg in args])
        captured = self._capsys.readouterr()
        assert "Traceback" not in captured.err + captured.out
        return Result(int(stop.value.code or 0), captured.out, captured.err)
