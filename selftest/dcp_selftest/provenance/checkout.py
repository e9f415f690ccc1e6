"""Reading the Markdown files of a specification from a folder or from a git repository."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path, PurePosixPath
from typing import Final

from dcp_conformance.errors import UsageError

from .statements import Statement, statements

#: Files by which the folder of the specification is recognised.
KNOWN: Final = (
    "dcp-architecture.md", "dcp-bp.md", "dcp-context.md", "dcp-datatypes.md", "dcp-issues.md", "dcp-srp.md",
    "dcp-vardis.md", "dcp-version-contributors.md",
)  # fmt: skip
#: Files of the same folder that state no rules: what changed, title, how to build it.
LEFT_OUT: Final = frozenset({"dcp-changelog.md", "frontmatter.md", "README.md"})


@dataclass(frozen=True, slots=True)
class Checkout:
    """One version of the specification."""

    origin: str
    """Folder, or repository and commit."""
    files: Mapping[str, str]
    """Text by file name, without the files that are left out."""

    def statements(self) -> list[Statement]:
        """The statements of all files, file by file in the order of their names."""
        return [each for name in sorted(self.files) for each in statements(name, self.files[name])]


def read_checkout(
    path: Path, revision: str | None = None, *, on_folder: Callable[[Path], object] = lambda _folder: None
) -> Checkout:
    """Read a specification from a folder (at any depth), or from the repository there at a revision.

    A bare repository without ``revision`` is read at HEAD. ``on_folder`` is called with each folder before it is
    searched. Raises :class:`UsageError` if there is no specification.
    """
    if not path.is_dir():
        raise UsageError(f"{path} is not a folder; give a checkout of the specification, or its git repository")
    if revision is not None or _is_bare(path):
        return _from_git(path, revision or "HEAD")
    names = list(_markdown_files(path, on_folder))
    folder, chosen = _folder(names, str(path))
    try:
        files = {PurePosixPath(name).name: (path / name).read_text(encoding="utf-8") for name in chosen}
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path}: the specification cannot be read: {error}") from None
    return Checkout(str(path / folder), files)


def _markdown_files(path: Path, on_folder: Callable[[Path], object]) -> Iterator[str]:
    """Yield the Markdown files below a folder, relative to it, without those of git; call ``on_folder``."""
    for name, folders, files in os.walk(path):
        folder = Path(name)
        on_folder(folder)
        folders[:] = sorted(set(folders) - {".git"})
        for file in sorted(files):
            if file.endswith(".md"):
                yield (folder / file).relative_to(path).as_posix()


def _folder(names: Iterable[str], where: str) -> tuple[PurePosixPath, list[str]]:
    """The folder that has most of the known files, and its Markdown files."""
    folders: dict[PurePosixPath, list[str]] = {}
    for name in names:
        folders.setdefault(PurePosixPath(name).parent, []).append(name)
    counts = {folder: sum(PurePosixPath(each).name in KNOWN for each in members) for folder, members in folders.items()}
    most = max(counts.values(), default=0)
    if not most:
        raise UsageError(
            f"{where} holds no DCP specification: none of its folders has a file such as {', '.join(KNOWN[:3])}"
        )
    best = sorted(folder for folder, count in counts.items() if count == most)
    if len(best) > 1:
        raise UsageError(f"{where} holds several specifications; give one of the folders {', '.join(map(str, best))}")
    return best[0], sorted(each for each in folders[best[0]] if PurePosixPath(each).name not in LEFT_OUT)


def _is_bare(path: Path) -> bool:
    return (path / "HEAD").is_file() and (path / "objects").is_dir()


def commit_of(path: Path, revision: str) -> str:
    """The full name of a commit. Raises :class:`UsageError` if the repository does not have it."""
    commit = _git(path, "rev-parse", "--verify", "--quiet", "--end-of-options", f"{revision}^{{commit}}").strip()
    if not commit:
        raise UsageError(f"{path} has no revision {revision!r}")
    return commit


def _from_git(path: Path, revision: str) -> Checkout:
    commit = commit_of(path, revision)
    listed = _git(path, "ls-tree", "-r", "-z", "--name-only", "--full-tree", commit).split("\0")
    _, chosen = _folder([name for name in listed if name.endswith(".md")], f"{path} at {revision}")
    files = {PurePosixPath(name).name: _git(path, "show", f"{commit}:{name}") for name in chosen}
    return Checkout(f"{path} at {commit[:12]}", files)


def _git(path: Path, *arguments: str) -> str:
    program = shutil.which("git")
    if program is None:
        raise UsageError("--rev and bare repositories need git, which is not installed; give a work tree instead")
    done = subprocess.run(  # noqa: S603 - no shell, and the revision comes after the options
        [program, "-C", str(path), *arguments], capture_output=True, check=False
    )
    if done.returncode and arguments[0] != "rev-parse":
        raise UsageError(f"{path}: git {arguments[0]}: {done.stderr.decode(errors='replace').strip()}")
    if done.returncode and b"not a git repository" in done.stderr:
        raise UsageError(f"{path} is not a git repository; leave --rev out to read the files of the folder")
    try:
        return done.stdout.decode()
    except UnicodeDecodeError as error:
        raise UsageError(f"{path}: the specification is not UTF-8: {error}") from None
