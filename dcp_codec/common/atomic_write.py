"""Atomic writing of files: they appear completely or not at all, also after a power failure."""

from __future__ import annotations

import errno
import os
import secrets
from pathlib import Path


def write_whole(path: Path, octets: bytes) -> None:
    """Write a file with ``octets`` to ``path`` in one step, with the access rights of any new file.

    An existing file is replaced; a folder, a device or a pipe is not. Raises OSError, whose filename is ``path``.
    """
    refuse_irregular(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        # The kernel applies the umask of the process; a thread cannot read the umask without changing it.
        handle = os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o666)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(octets)
                file.flush()
                os.fsync(file.fileno())
            rename_durably(temporary, path)
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        # The name of the temporary file means nothing to the user.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def rename_durably(made: Path, path: Path) -> None:
    """Rename ``made``, whose content is already on the disk, to ``path``, and wait until the disk has the new name."""
    made.replace(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until a file's content or a folder's entries are on the disk. A pipe, which cannot be synchronised, is
    skipped.
    """
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        # The folder allows the creation of files but not their listing.
        return
    try:
        os.fsync(fd)
    except OSError as error:
        if error.errno not in (errno.EINVAL, errno.ENOTSUP, errno.EROFS):
            raise
    finally:
        os.close(fd)


def sync_tree(path: Path) -> None:
    """Synchronise a file, or a folder with everything in it."""
    for folder, _, files in os.walk(path):
        for name in files:
            sync(Path(folder, name))
        sync(Path(folder))
    if not path.is_dir():
        sync(path)


def refuse_irregular(path: Path) -> None:
    """Raise OSError if ``path`` is, for example, a device, which the user does not mean to replace by a rename."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EEXIST, "is not a regular file and will not be replaced", str(path))
