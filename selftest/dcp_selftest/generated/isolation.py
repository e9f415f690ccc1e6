"""Run functions in new processes that import one module of the project from changed code.

The changed code must be installed before the node is imported for the first time. It can crash the node or cause an
endless loop.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final

from dcp_codec.common.workers import Worker

#: Timeout of a process in seconds of real time; long, because the processors may be busy with other work.
_PATIENCE: Final = 600.0


class _Importer(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Finder and loader that imports one module from changed code."""

    def __init__(self, name: str, code: CodeType) -> None:
        self._name = name
        self._code = code

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """Return the specification of the changed module; None for every other."""
        del path, target
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: ModuleType) -> None:
        """Execute the changed code in the module."""
        exec(self._code, module.__dict__)  # noqa: S102 - our own source with one change


def import_changed(name: str, code: CodeType) -> None:
    """Make the first import of the module ``name`` execute ``code``. The module must not have been imported yet."""
    sys.meta_path.insert(0, _Importer(name, code))


def process_context(*more: str) -> ForkServerContext:
    """Return a context whose processes have already imported the modules that no change affects, and ``more``."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload", *more])
    return context


def ask(context: ForkServerContext, work: Callable[..., bytes], *arguments: object) -> tuple[bytes, str]:
    """Call ``work`` in a new process; return its result and an empty text, or no octets and how the process ended."""
    worker = Worker(context, _child, work, *arguments)
    try:
        if worker.connection.poll(_PATIENCE):
            return worker.connection.recv_bytes(), ""
        return b"", f"did not end within {_PATIENCE:g} s"
    except (EOFError, OSError):
        return b"", f"its process ended with status {worker.status()}"
    finally:
        worker.end(0)


def _child(to: Connection, work: Callable[..., bytes], *arguments: object) -> None:
    # Discard the output: a broken node may write any number of messages.
    with Path(os.devnull).open("r+b") as nowhere:
        for descriptor in (1, 2):
            os.dup2(nowhere.fileno(), descriptor)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    to.send_bytes(work(*arguments))
    to.close()
