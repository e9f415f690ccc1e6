"""Reading the files that a user gives to a command."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from dcp_conformance.errors import UsageError

T = TypeVar("T")


def load_file(path: Path, kind: type[T], *, decode: Callable[..., Any] = msgspec.json.decode, what: str = "") -> T:
    """Return the contents of a JSON file as ``kind``; for TOML, ``decode`` is ``msgspec.toml.decode``.

    Raises ``UsageError`` with the path and the cause if the file cannot be read or has other contents. ``what``: what
    the file should be, for the message.
    """
    try:
        found: T = decode(path.read_bytes(), type=kind)
    except OSError as error:
        raise UsageError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (msgspec.DecodeError, UnicodeDecodeError, RecursionError, re.error) as error:
        expected = f"not {what}: " if what else ""
        raise UsageError(f"{path}: {expected}{error}") from None
    return found
