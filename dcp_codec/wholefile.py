"""Files that are there as a whole or not at all."""

from __future__ import annotations

import errno
import os
import tempfile
from pathlib import Path


def write_whole(path: Path, octets: bytes) -> None:
    """Put a file with ``octets`` at ``path``, in one step, with the rights that any new file gets.

    A file that is there is replaced; a folder, a device or a pipe is not. Raises OSError, whose filename is ``path``.
    """
    refuse_irregular(path)
    try:
        handle, name = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(octets)
            # mkstemp is for secrets; this is a file as any other.
            Path(name).chmod(0o666 & ~_umask())
            Path(name).replace(path)
        except BaseException:
            Path(name).unlink(missing_ok=True)
            raise
    except OSError as error:
        # The name of the file on the way there means nothing to anybody.
        raise OSError(error.errno, error.strerror or str(error), str(path)) from None


def refuse_irregular(path: Path) -> None:
    """Raise OSError if something is there that nobody means to lose by renaming a file onto it, such as a device."""
    if path.exists() and not path.is_file():
        raise OSError(errno.EEXIST, "is no regular file, and is not replaced", str(path))


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
