"""Compile functions of this package with Numba; later processes reuse the machine code where possible.

The functions are plain Python. Numba is imported only when machine code is requested for the first time, so that
decoding a small recording needs neither the import nor the compilation.
"""

from __future__ import annotations

import fcntl
import logging
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Logger of the message, once in a process and at level INFO, that the decoder is compiled (about ten seconds).
LOG = logging.getLogger("dcp_tables.table.compiling")
COMPILING = "compiling the decoder, once; this takes about ten seconds"

#: Functions that compiled functions call, and the number of them that are registered with Numba.
_helpers: list[Callable[..., Any]] = []
_known = 0


def options_of(registry: str) -> dict[str, Any]:
    """Return the options for Numba. ``registry`` is the name of Numba's module that defines the available options.

    ``nogil`` lets other threads run. ``_nrt=False`` disables reference counts of arrays, which took up to a fifth of
    the time; such functions cannot create arrays. This internal option exists in Numba 0.60 to 0.68. Without it only
    the speed differs.
    """
    options: dict[str, Any] = {"nogil": True}
    try:
        known = import_module(registry).cpu_target.options
    except (ImportError, AttributeError):
        return options
    return options | {"_nrt": False} if hasattr(known, "_nrt") else options


@cache
def options() -> dict[str, Any]:
    """Return the options of the installed Numba for functions that create no arrays."""
    return options_of("numba.core.registry")


def helper(function: _Function) -> _Function:
    """Mark a function that compiled functions call; it is compiled as a part of them. Return it unchanged."""
    _helpers.append(function)
    return function


def machine(function: _Function, lock: Path | None = None) -> _Function:
    """Return ``function`` as machine code that runs without the GIL; it is compiled at the first call.

    Numba stores it beside the source or in the user's cache. If neither can be written, each process compiles again.
    ``lock``: the file that is locked during the first call, by default the source: of several processes one compiles,
    and the others wait and load the machine code that it has stored.
    All calls must have the same argument types: concurrent processes that store machine code for several mix them up.
    """
    return cast(_Function, _once(function, lock or Path(function.__code__.co_filename)))


@contextmanager
def locked(path: Path) -> Iterator[None]:
    """Keep other processes and threads out of a ``with`` block with the same ``path``, a file that exists.

    Without such a file, or on a file system without locks, the block is executed at once.
    """
    with ExitStack() as stack:
        with suppress(OSError):
            fcntl.flock(stack.enter_context(path.open("rb")), fcntl.LOCK_EX)
        yield


@cache
def _once(function: Callable[..., Any], lock: Path) -> Callable[..., Any]:
    decode, ready = _compiled(function), False

    def call(*arguments: Any) -> Any:
        nonlocal ready
        if ready:
            return decode(*arguments)
        with locked(lock):
            result = decode(*arguments)
        ready = True
        return result

    return call


@cache
def _compiled(function: Callable[..., Any]) -> Any:
    from numba import njit

    _prepare()
    try:
        return njit(cache=True, **options())(function)
    except RuntimeError:
        return njit(**options())(function)


class _Announcer(logging.Handler):
    """Logging handler that calls a function with the text of each record."""

    def __init__(self, say: Callable[[str], object]) -> None:
        super().__init__(logging.INFO)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(record.getMessage())


def announce(say: Callable[[str], object]) -> logging.Handler:
    """Call ``say`` with a message for the user when the process compiles; return the handler for removal."""
    handler = _Announcer(say)
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    return handler


@contextmanager
def announcing(say: Callable[[str], object]) -> Iterator[None]:
    """Call ``say`` with a message for the user when the process compiles during the ``with`` block."""
    level = LOG.level
    handler = announce(say)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _prepare() -> None:
    """Register all helpers with Numba, and log its compilations."""
    global _known
    from numba.extending import register_jitable

    if not _known:
        _watch()
    inner = {name: value for name, value in options().items() if name != "nogil"}
    for function in _helpers[_known:]:
        register_jitable(**inner)(function) if inner else register_jitable(function)
    _known = len(_helpers)


def _watch() -> None:
    from numba.core import event

    class Listener(event.Listener):
        said = False

        def on_start(self, event: Any) -> None:
            own = (event.data["dispatcher"].py_func.__module__ or "").startswith("dcp_codec")
            if own and not self.said:
                self.said = True
                LOG.info(COMPILING)

        def on_end(self, event: Any) -> None:
            pass

    register: Any = event.register
    register("numba:compile", Listener())
