"""Default places of the control socket of a node."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Final

SYSTEM: Final = Path("/run/dcp/node.sock")
"""The socket of a node that runs as a system service or as root."""


def default_socket() -> Path | None:
    """Return the default socket of a node: in the user's runtime folder, or :data:`SYSTEM` for root without one.

    None for other users without a runtime folder (XDG_RUNTIME_DIR): a folder that all users may write to is not safe.
    """
    own = _own()
    if own is not None:
        return own
    return SYSTEM if os.geteuid() == 0 else None


def places() -> list[Path]:
    """Return the places where a client looks for a node, in this order: the user's own, then that of the system."""
    own = _own()
    return [SYSTEM] if own is None else [own, SYSTEM]


def find_socket() -> Path | None:
    """Return the first of :func:`places` that exists; None if none does."""
    return next((path for path in places() if path.exists()), None)


def is_answered(path: Path) -> bool:
    """Whether a program listens at a socket; also True if the system does not tell, for example without permission."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as trial:
        trial.settimeout(1)
        try:
            trial.connect(os.fspath(path))
        except (ConnectionRefusedError, FileNotFoundError):
            return False
        except OSError:
            # BlockingIOError: a program listens, but has too many clients at the moment.
            return True
    return True


def _own() -> Path | None:
    """Return the socket in the user's runtime folder; None if there is no such folder."""
    folder = os.environ.get("XDG_RUNTIME_DIR", "")
    # The specification of this variable (XDG Base Directory) requires an absolute path.
    return Path(folder) / "dcp-node.sock" if folder.startswith("/") and Path(folder).is_dir() else None
