"""Machine code from functions of this package, kept for the next process where that can be.

The functions themselves are plain Python, and Numba is imported when the first of them is asked for as machine code:
whoever decodes a small recording waits for neither.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from importlib import import_module
from typing import Any, TypeVar, cast

_Function = TypeVar("_Function", bound=Callable[..., Any])

#: Says at level INFO, once in a process, that something has to be compiled; that takes about ten seconds.
LOG = logging.getLogger("dcp_codec.table.compiling")
COMPILING = "compiling the decoder, once; this takes about ten seconds"

#: Functions that others call in machine code, and how many of them Numba knows.
_helpers: list[Callable[..., Any]] = []
_known = 0


def options_of(registry: str) -> dict[str, Any]:
    """What Numba is told; ``registry``: its module that says which options there are.

    Other threads may run. References to arrays are not counted, which took up to a fifth of the time: a function has to
    make do with the arrays that it is given. That option is Numba's own (0.60 to 0.68 have it): where there is none, or
    no such module, it is left out, and everything is the same but for the time.
    """
    options: dict[str, Any] = {"nogil": True}
    try:
        known = import_module(registry).cpu_target.options
    except (ImportError, AttributeError):
        return options
    return options | {"_nrt": False} if hasattr(known, "_nrt") else options


@cache
def options() -> dict[str, Any]:
    """The options for functions that make no arrays."""
    return options_of("numba.core.registry")


def helper(function: _Function) -> _Function:
    """Mark a function that others call in machine code, of which it becomes a part. It stays plain Python."""
    _helpers.append(function)
    return function


def machine(function: _Function) -> _Function:
    """``function`` as machine code that lets other threads run; compiled when it is first called.

    Numba keeps it beside the source or in the user's cache. Where neither can be written, each process compiles anew.
    It is for arguments of one kind: processes that keep machine code for several at once mix them up.
    """
    return cast(_Function, _compiled(function))


@cache
def _compiled(function: Callable[..., Any]) -> Any:
    from numba import njit

    _prepare()
    try:
        return njit(cache=True, **options())(function)
    except RuntimeError:
        return njit(**options())(function)


class _Announcer(logging.Handler):
    """Passes what is logged on as text."""

    def __init__(self, say: Callable[[str], object]) -> None:
        super().__init__(logging.INFO)
        self._say = say

    def emit(self, record: logging.LogRecord) -> None:
        self._say(record.getMessage())


def announce(say: Callable[[str], object]) -> logging.Handler:
    """Call ``say`` with one sentence for people when something has to be compiled, as long as the process lives."""
    handler = _Announcer(say)
    LOG.addHandler(handler)
    LOG.setLevel(logging.INFO)
    return handler


@contextmanager
def announcing(say: Callable[[str], object]) -> Iterator[None]:
    """As :func:`announce` for the time of a with-block."""
    level = LOG.level
    handler = announce(say)
    try:
        yield
    finally:
        LOG.removeHandler(handler)
        LOG.setLevel(level)


def _prepare() -> None:
    """Have Numba know all helpers, and say when it compiles."""
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
