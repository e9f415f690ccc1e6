"""Files that are there as a whole or not at all, also after the power has failed."""

from __future__ import annotations

import errno
import os
import secrets
from pathlib import Path


def write_whole(path: Path, octets: bytes) -> None:
    """Put a file with ``octets`` at ``path``, in one step, with the rights that any new file gets.

    A file that is there is replaced; a folder, a device or a pipe is not. Raises OSError, whose filename is ``path``.
    """
    refuse_irregular(path)
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        # The system applies the umask of the process, which a thread cannot ask for without changing it.
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
        # The name of the file on the way there means nothing to anybody.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def rename_durably(made: Path, path: Path) -> None:
    """Rename ``made``, whose content is on the disk already, to ``path``, and wait until the disk has the new name."""
    made.replace(path)
    sync(path.parent)


def sync(path: Path) -> None:
    """Wait until the disk has a file's content or a folder's names. What cannot be synchronised (a pipe) is left."""
    try:
        fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC)
    except OSError:
        # A folder in which names can be made but not listed.
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
    """Raise OSError if something is there that nobody means to lose by renaming a file onto it, such as a device."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EEXIST, "is no regular file, and is not replaced", str(path))
