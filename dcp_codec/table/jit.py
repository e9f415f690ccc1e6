"""Machine code from functions of this package, kept for the next process where that can be."""

from __future__ import annotations

from collections.abc import Callable
from importlib import import_module
from typing import Any, Final, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


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


#: For functions that make no arrays.
OPTIONS: Final = options_of("numba.core.registry")


def machine(function: _Function) -> _Function:
    """``function`` as machine code that lets other threads run; compiled when it is first called.

    Numba keeps it beside the source or in the user's cache. Where neither can be written, each process compiles anew.
    It is for arguments of one kind: processes that keep machine code for several at once mix them up.
    """
    try:
        compiled: Any = njit(cache=True, **OPTIONS)(function)
    except RuntimeError:
        compiled = njit(**OPTIONS)(function)
    return cast(_Function, compiled)


def helper(function: _Function) -> _Function:
    """``function`` as machine code that is kept as a part of those who call it, for arguments of any kind."""
    return cast(_Function, njit(nogil=True)(function))
