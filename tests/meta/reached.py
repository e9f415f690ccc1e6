"""Pytest plugin: record which functions of the product each test executes, with its CPU seconds.

``pytest -p reached`` with this folder on PYTHONPATH and ``DCP_REACHED=FOLDER`` writes one file of JSON lines for each
worker: ``{"new": {number: "path:line"}}`` and ``{"id": ..., "cpu": ..., "functions": [numbers]}``. Functions that a
test executes in other processes are not seen. ``mutation.py`` reads the files.
"""

from __future__ import annotations

import cProfile
import json
import os
from collections.abc import Iterator
from pathlib import Path
from types import CodeType
from typing import IO

import pytest

ROOT = f"{Path(__file__).resolve().parents[2]}/"
PRODUCT = tuple(f"{ROOT}{name}/" for name in ("spec", "dcp_codec", "dcp_stack", "conformance"))
_output: IO[str] | None = None
_numbers: dict[str, int] = {}


def pytest_configure(config: pytest.Config) -> None:
    global _output
    worker = getattr(config, "workerinput", {}).get("workerid")
    if worker is not None:
        folder = Path(os.environ["DCP_REACHED"])
        folder.mkdir(parents=True, exist_ok=True)
        _output = (folder / f"{worker}.jsonl").open("w", encoding="utf-8")


def pytest_sessionfinish() -> None:
    if _output is not None:
        _output.close()


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    if _output is None:
        return (yield)
    profiler = cProfile.Profile(subcalls=False, builtins=False)
    begun = os.times()
    profiler.enable()
    try:
        return (yield)
    finally:
        profiler.disable()
        spent = sum(os.times()[:4]) - sum(begun[:4])
        new, reached = {}, []
        for code in (each.code for each in profiler.getstats()):
            if isinstance(code, CodeType) and code.co_filename.startswith(PRODUCT):
                place = f"{code.co_filename.removeprefix(ROOT)}:{code.co_firstlineno}"
                if place not in _numbers:
                    new[_numbers.setdefault(place, len(_numbers))] = place
                reached.append(_numbers[place])
        if new:
            _output.write(json.dumps({"new": new}) + "\n")
        _output.write(json.dumps({"id": item.nodeid, "cpu": round(spent, 4), "functions": reached}) + "\n")
