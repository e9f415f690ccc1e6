"""Check whether other users can change files that decide what a process executes."""

from __future__ import annotations

import grp
import os
import pwd
import stat
from collections.abc import Collection
from pathlib import Path

_ROOT = 0


def untrusted_writer(path: Path, *, owners: Collection[int] = ()) -> str | None:
    """Describe which other user can change ``path``; None if only this user, root and ``owners`` (user ids) can.

    Checks the file or folder itself, the target of a link, and all folders above both. A folder with the sticky bit
    (``/tmp``) counts as safe, since users cannot replace each other's files in it. Write permission for the private
    group of an owner (the group with the owner's name) counts as safe, too. Raises OSError if a file or folder cannot
    be examined.
    """
    trusted = {_ROOT, os.geteuid(), *owners}
    for each in _chain(path):
        status = each.lstat()
        if stat.S_ISLNK(status.st_mode):
            # Mode and owner of the folder decide who can replace a link.
            continue
        if status.st_uid not in trusted:
            return f"{each} belongs to user {_user(status.st_uid)}, who can change it"
        if status.st_mode & stat.S_ISVTX and stat.S_ISDIR(status.st_mode):
            continue
        if status.st_mode & stat.S_IWOTH:
            return f"{each} can be changed by every user (mode {stat.S_IMODE(status.st_mode):04o})"
        if status.st_mode & stat.S_IWGRP and not _is_private_group(status.st_gid, trusted):
            return f"{each} can be changed by group {_group(status.st_gid)} (mode {stat.S_IMODE(status.st_mode):04o})"
    return None


def invoking_user() -> tuple[int, ...]:
    """Return the user who became root by ``sudo``, whom root trusts; empty without ``sudo``."""
    value = os.environ.get("SUDO_UID", "")
    return (int(value),) if os.geteuid() == _ROOT and value.isascii() and value.isdigit() else ()


def _chain(path: Path) -> list[Path]:
    """Return the path as given and as resolved, each with all folders above it."""
    written = Path(os.path.abspath(path))  # noqa: PTH100 - resolve() would follow links
    found = [written, *written.parents]
    resolved = path.resolve()
    found += [each for each in (resolved, *resolved.parents) if each not in found]
    return found


def _is_private_group(gid: int, owners: Collection[int]) -> bool:
    if gid == _ROOT:
        return True
    name = _group(gid)
    return any(_user(uid) == name for uid in owners)


def _user(uid: int) -> str:
    try:
        return pwd.getpwuid(uid).pw_name
    except KeyError:
        return str(uid)


def _group(gid: int) -> str:
    try:
        return grp.getgrgid(gid).gr_name
    except KeyError:
        return str(gid)
