"""Work in new processes that import one module of the project from changed code.

A change must be in place before the node is imported for the first time, and may make the node die or never end.
"""

from __future__ import annotations

import importlib.abc
import importlib.machinery
import importlib.util
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor, as_completed
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerContext
from pathlib import Path
from types import CodeType, ModuleType
from typing import Final, TypeVar

T = TypeVar("T")
R = TypeVar("R")
#: Seconds that a process may take by the clock: the processors may have other work.
_PATIENCE: Final = 600.0


class _Importer(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Imports one module from changed code."""

    def __init__(self, name: str, code: CodeType) -> None:
        self._name = name
        self._code = code

    def find_spec(
        self, fullname: str, path: Sequence[str] | None = None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """The changed module; None for every other."""
        del path, target
        return importlib.util.spec_from_loader(fullname, self) if fullname == self._name else None

    def exec_module(self, module: ModuleType) -> None:
        """Run the changed code."""
        exec(self._code, module.__dict__)  # noqa: S102 - our own source with one change


def import_changed(name: str, code: CodeType) -> None:
    """Let the next import of a module run this code. The module must not be imported yet."""
    sys.meta_path.insert(0, _Importer(name, code))


def process_context() -> ForkServerContext:
    """Processes that have imported what no change touches."""
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([f"{__package__}.preload"])
    return context


def ask(context: ForkServerContext, work: Callable[..., bytes], *arguments: object) -> tuple[bytes, str]:
    """Return what ``work`` returns in a new process; if it returns nothing, how that process ended."""
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_child, args=(theirs, work, *arguments), daemon=True)
    process.start()
    theirs.close()
    try:
        if ours.poll(_PATIENCE):
            return ours.recv_bytes(), ""
        return b"", f"did not come to an end within {_PATIENCE:g} s"
    except (EOFError, OSError):
        process.join(5)
        return b"", f"its process ended with status {process.exitcode}"
    finally:
        process.kill()
        process.join()
        ours.close()


def _child(to: Connection, work: Callable[..., bytes], *arguments: object) -> None:
    # A broken node may write any amount of messages.
    with Path(os.devnull).open("r+b") as nowhere:
        for descriptor in (1, 2):
            os.dup2(nowhere.fileno(), descriptor)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    to.send_bytes(work(*arguments))
    to.close()


def concurrently(work: Callable[[T], R], items: Iterable[T], jobs: int | None, on_result: Callable[[R], None]) -> None:
    """Call ``on_result`` with the result of ``work`` for each item as they come, from ``jobs`` threads.

    For work that waits for processes; None: a thread for each processor. An interrupt, also one during ``on_result``,
    ends it early without an exception: what has not begun is left out.
    """
    with ThreadPoolExecutor(jobs or os.cpu_count() or 1) as pool:
        waiting = [pool.submit(work, each) for each in items]
        try:
            for done in as_completed(waiting):
                on_result(done.result())
        except KeyboardInterrupt:
            pool.shutdown(cancel_futures=True)
