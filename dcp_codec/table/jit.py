"""Machine code from functions of this package, kept for the next process where that can be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

#: Other threads may run. References to arrays are not counted, which took up to a fifth of the time: a function has to
#: make do with the arrays that it is given.
OPTIONS: dict[str, Any] = {"nogil": True, "_nrt": False}

_Function = TypeVar("_Function", bound=Callable[..., Any])


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
