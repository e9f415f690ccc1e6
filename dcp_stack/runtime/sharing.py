"""Access to the control socket for other users: its group and mode."""

from __future__ import annotations

import grp
import os
import stat
from pathlib import Path

from .settings import SettingsError


def parse_mode(text: str) -> int:
    """Return the octal mode ``text``, such as ``"0660"``.

    Raises SettingsError if it is not a mode, or would deny access to the owner.
    """
    try:
        mode = int(text, 8)
    except ValueError:
        mode = -1
    if not 0 <= mode <= 0o777 or mode & 0o600 != 0o600:
        raise SettingsError(f'control_mode: {text!r} is not a mode of a socket; "0660" lets a group use it')
    return mode


def find_group(name: str) -> int:
    """Return the number of a group given by name or number. Raises SettingsError if it does not exist."""
    if name.isdecimal():
        return int(name)
    try:
        return grp.getgrnam(name).gr_gid
    except KeyError:
        raise SettingsError(f"control_group: there is no group {name!r} (groupadd --system {name})") from None


def share(path: Path, group: str | None, mode: str | None) -> None:
    """Set group and mode of a socket; with a group and no mode, the mode is 0660.

    Raises SettingsError if the group does not exist, or if the node is neither in it nor root.
    """
    if group is None and mode is None:
        return
    gid = -1 if group is None else find_group(group)
    bits = parse_mode(mode) if mode is not None else 0o660
    # By descriptor: a user with write access to the folder could replace the socket by a link to another file.
    fd = os.open(path, os.O_PATH | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if not stat.S_ISSOCK(os.fstat(fd).st_mode):
            raise SettingsError(f"{path}: it is not a socket any more")
        itself = Path(f"/proc/self/fd/{fd}")
        os.chown(itself, -1, gid)
        itself.chmod(bits)
    except PermissionError:
        raise SettingsError(f"control_group: the node is not in group {group}, so it cannot share its socket") from None
    finally:
        os.close(fd)
