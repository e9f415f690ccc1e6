"""Machine code from functions of this package, kept for the next process where that can be."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar, cast

from numba import njit

_Function = TypeVar("_Function", bound=Callable[..., Any])


def machine(function: _Function) -> _Function:
    """``function`` as machine code that lets other threads run; compiled when it is first called.

    Numba keeps it beside the source or in the user's cache. Where neither can be written, each process compiles anew.
    """
    try:
        compiled: Any = njit(cache=True, nogil=True, _nrt=False)(function)
    except RuntimeError:
        compiled = njit(nogil=True, _nrt=False)(function)
    return cast(_Function, compiled)
