"""Where the control socket of a node is if the user does not say."""

from __future__ import annotations

import contextlib
import os
import socket
from pathlib import Path
from typing import Final

SYSTEM: Final = Path("/run/dcp/node.sock")
"""The socket of a node that runs as a service of the system, or as root."""


def default_socket() -> Path | None:
    """Where a node listens by default: in the user's runtime folder, or :data:`SYSTEM` for root without one.

    None for a user without a runtime folder (XDG_RUNTIME_DIR): a folder that all may write to is no place for it.
    """
    own = _own()
    if own is not None:
        return own
    return SYSTEM if os.geteuid() == 0 else None


def places() -> list[Path]:
    """Where a client looks for a node, in this order: the user's own, then that of the system."""
    own = _own()
    return [SYSTEM] if own is None else [own, SYSTEM]


def find_socket() -> Path | None:
    """The first of :func:`places` at which there is something; None if there is nothing."""
    return next((path for path in places() if path.exists()), None)


def is_answered(path: Path) -> bool:
    """Whether a program listens at a socket."""
    with contextlib.closing(socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)) as trial:
        trial.settimeout(1)
        try:
            trial.connect(os.fspath(path))
        except BlockingIOError:
            # Somebody does, and has too many clients at the moment.
            return True
        except OSError:
            return False
    return True


def _own() -> Path | None:
    folder = os.environ.get("XDG_RUNTIME_DIR", "")
    # The specification of this variable asks for an absolute path.
    return Path(folder) / "dcp-node.sock" if folder.startswith("/") and Path(folder).is_dir() else None
