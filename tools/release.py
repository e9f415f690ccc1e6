"""Build everything that a release consists of: ``python -m tools.release [FOLDER]``, by default ``build/release``.

Wheel and source distribution of the kit, wheels of laboratory, tables and self-test, the generated C and Rust of the
main profiles with the example node, test vectors with their runners, the documentation site, the container file, and
SHA-256 sums. Archives of one commit are equal: their files have the date of the commit and no owner.
"""

from __future__ import annotations

import argparse
import gzip
import hashlib
import io
import shutil
import subprocess
import sys
import tarfile
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from dcp_conformance.vectors.files import files
from dcp_spec.profile.loading import profile_names
from dcp_spec.version import __version__

from dcp_codec.codec import get_codec
from dcp_codec.export.c.adapter import adapter_files
from dcp_codec.export.c.files import codec_files
from dcp_codec.export.rust.module import rust_module

from .docs.__main__ import build
from .docs.staging import with_links

ROOT = Path(__file__).resolve().parents[1]
#: The profiles whose codec is in the archive: every version of the specification, and the public implementation.
PROFILES = ("dcp-1.0", "dcp-1.1", "dcp-1.2", "dcp-1.3", "dcp-2.0", "cpp-1.3", "cpp-2.0")
EXAMPLE = ROOT / "examples" / "c-node"
#: Pages of the archive of C, by their place in this repository.
C_PAGES = {
    "docs/c.md": "README.md",
    "examples/c-node/README.md": "c-node/README.md",
    "conformance/UPPER-TESTER.md": "UPPER-TESTER.md",
}
RUNNERS = ROOT / "examples" / "vectors"


def archive(target: Path, top: str, files: Mapping[str, bytes], date: int) -> None:
    """Write a ``.tar.gz`` of files below the folder ``top``."""
    octets = io.BytesIO()
    with tarfile.open(fileobj=octets, mode="w", format=tarfile.PAX_FORMAT) as tar:
        for name in sorted(files):
            entry = tarfile.TarInfo(f"{top}/{name}")
            entry.size, entry.mtime, entry.mode = len(files[name]), date, 0o644
            tar.addfile(entry, io.BytesIO(files[name]))
    target.write_bytes(gzip.compress(octets.getvalue(), mtime=date))


def files_below(folder: Path) -> dict[str, bytes]:
    """Return the files of a folder by their path in it."""
    paths = [path for path in folder.rglob("*") if path.is_file()]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def c_files(profiles: Sequence[str] = PROFILES) -> dict[str, bytes]:
    """Return the generated C and Rust: a folder for each profile, and the example node with that of 2.0."""
    found = {"LICENSE": (ROOT / "LICENSE").read_bytes()}
    for name in profiles:
        codec = get_codec(name)
        made = {**codec_files(codec), **adapter_files(codec)}
        found[f"{name}/dcp_codec.rs"] = rust_module(codec).encode()
        found |= {f"{name}/{file}": text.encode() for file, text in made.items()}
        if name == "dcp-2.0":
            found |= {f"c-node/{file}": text.encode() for file, text in made.items()}
    tracked = _output("git", "ls-files", EXAMPLE.relative_to(ROOT).as_posix()).split()
    found |= {f"c-node/{Path(each).name}": (ROOT / each).read_bytes() for each in tracked}
    pages = {source: with_links((ROOT / source).read_text(), source, page, C_PAGES) for source, page in C_PAGES.items()}
    return found | {C_PAGES[source]: text.encode() for source, text in pages.items()}


def vector_files(profiles: Sequence[str] | None = None) -> dict[str, bytes]:
    """Return the test vectors of some profiles, by default of all, and the runners."""
    found = {"LICENSE": (ROOT / "LICENSE").read_bytes(), **dict(files(profiles or profile_names()))}
    tracked = _output("git", "ls-files", RUNNERS.relative_to(ROOT).as_posix()).split()
    runners = {str(Path(each).relative_to(RUNNERS.relative_to(ROOT))): (ROOT / each).read_bytes() for each in tracked}
    return found | {f"runners/{name}": octets for name, octets in runners.items()}


def _output(*command: str) -> str:
    return subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout  # noqa: S603


def main() -> int:
    """Build the release; return the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tools.release", description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", nargs="?", type=Path, default=ROOT / "build" / "release")
    parser.add_argument("--without-site", action="store_true", help="leave out the documentation site")
    options = parser.parse_args()
    folder: Path = options.folder.resolve()
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    date = int(_output("git", "log", "-1", "--format=%ct"))
    for project in (ROOT, ROOT / "lab", ROOT / "tables", ROOT / "selftest"):
        for target in ("wheel", "sdist") if project == ROOT else ("wheel",):
            command = [sys.executable, "-m", "hatchling", "build", "-d", str(folder), "-t", target]
            subprocess.run(command, cwd=project, check=True, stdout=subprocess.DEVNULL)  # noqa: S603
    archive(folder / f"dcp-c-{__version__}.tar.gz", f"dcp-c-{__version__}", c_files(), date)
    archive(folder / f"dcp-vectors-{__version__}.tar.gz", f"dcp-vectors-{__version__}", vector_files(), date)
    if not options.without_site:
        with tempfile.TemporaryDirectory() as work:
            site = Path(work) / "result"
            if status := build(Path(work) / "docs", site):
                return status
            archive(folder / f"dcp-site-{__version__}.tar.gz", f"dcp-site-{__version__}", files_below(site), date)
    shutil.copy(ROOT / "examples" / "Containerfile", folder / "Containerfile")
    sums = [f"{hashlib.sha256(path.read_bytes()).hexdigest()}  {path.name}\n" for path in sorted(folder.iterdir())]
    (folder / "SHA256SUMS").write_text("".join(sums), encoding="utf-8")
    for path in sorted(folder.iterdir()):
        print(f"{path.stat().st_size:>10}  {path}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
