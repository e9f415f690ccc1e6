"""Giving up the privileges of root after everything that needs them is open."""

from __future__ import annotations

import os
import pwd
import stat
from pathlib import Path
from typing import NamedTuple

from dcp_codec.common.trust import untrusted_writer

from .errors import NodeError


class PrivilegeError(NodeError):
    """The privileges cannot be given up; the message names the cause."""


class User(NamedTuple):
    """A user of the system to run as."""

    name: str
    uid: int
    gid: int


def find_user(name: str) -> User:
    """Return the user ``name``. Raises PrivilegeError if it does not exist, or this process is not root."""
    try:
        entry = pwd.getpwnam(name)
    except KeyError:
        raise PrivilegeError(f"user {name}: there is no such user") from None
    if os.geteuid() != 0:
        raise PrivilegeError(f"user {name}: only root can change to another user; leave it out, or start as root")
    return User(name, entry.pw_uid, entry.pw_gid)


def roots_alone(folder: Path) -> bool:
    """Whether only root can create, replace or remove anything in a folder, and the folder itself."""
    try:
        return not folder.stat().st_mode & (stat.S_IWGRP | stat.S_IWOTH) and untrusted_writer(folder) is None
    except OSError:
        return False


def made_by_root(path: str) -> bool:
    """Return whether root opens a file for writing before it changes to a user, who opens all others.

    Root could be made to follow a link of that user to another place. In a folder that only root can change there is no
    such link.
    """
    return roots_alone(Path(path).parent)


def become(user: User) -> None:
    """Change to ``user`` permanently. Raises PrivilegeError if the system refuses."""
    try:
        os.initgroups(user.name, user.gid)
        os.setgid(user.gid)
        os.setuid(user.uid)
    except OSError as error:
        raise PrivilegeError(f"user {user.name}: {error.strerror}") from None
    if user.uid and os.getuid() != user.uid:
        raise PrivilegeError(f"user {user.name}: the system did not change the user")
