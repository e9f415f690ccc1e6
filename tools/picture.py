"""Make the picture of the README: ``python -m tools.picture``; it needs chromium.

The suite runs against a mutant of the reference node over UDP, and chromium takes a picture of the report. The picture
has the version of the kit in a text chunk, so that a test can tell when it is out of date.
"""

from __future__ import annotations

import os
import struct
import subprocess
import sys
import tempfile
import zlib
from pathlib import Path
from typing import Final

from dcp_spec.version import __version__

PICTURE: Final = Path(__file__).resolve().parents[1] / "docs" / "report.png"
MUTANT: Final = "M-VD-RU-03-equal-answered"
CASES: Final = "TC_VD_*"
_SIGNATURE: Final = b"\x89PNG\r\n\x1a\n"
#: Octets of the signature and of the first chunk, which must come first.
_HEAD: Final = len(_SIGNATURE) + 25


def with_version(picture: bytes, version: str) -> bytes:
    """Return a PNG file with a version in a text chunk."""
    body = b"tEXt" + b"Software\0dcp-conformance " + version.encode("ascii")
    chunk = struct.pack(">I", len(body) - 4) + body + struct.pack(">I", zlib.crc32(body))
    return picture[:_HEAD] + chunk + picture[_HEAD:]


def version_of(picture: bytes) -> str:
    """Return the version that :func:`with_version` has put into a PNG file; empty if there is none."""
    size = struct.unpack_from(">I", picture, _HEAD)[0]
    name, _, version = picture[_HEAD + 8 : _HEAD + 8 + size].decode("latin-1").rpartition(" ")
    return version if name == "Software\0dcp-conformance" else ""


def main() -> int:
    """Make the picture; return the exit status."""
    programs = Path(sys.executable).parent
    with tempfile.TemporaryDirectory() as work:
        node = f"python -m dcp_selftest.mutants {MUTANT} --link udp --control node.sock --beacon-period 50"
        options = ["--link", "udp", "--start", node, "--ut", "unix:node.sock", "--beacon-period", "50"]
        command = [str(programs / "dcp-conformance"), "run", *options, "--report-dir", "report", CASES]
        path = {**os.environ, "PATH": f"{programs}{os.pathsep}{os.environ['PATH']}"}
        found = subprocess.run(command, cwd=work, env=path, check=False, stdout=subprocess.DEVNULL)  # noqa: S603
        status = found.returncode
        if status != 1:
            print(f"the suite ended with status {status}, not 1: {' '.join(command)}", file=sys.stderr)
            return 1
        page = f"file://{work}/report/report.html"
        shot = ["chromium", "--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1180,1340"]
        subprocess.run([*shot, f"--screenshot={work}/report.png", page], check=True, stderr=subprocess.DEVNULL)  # noqa: S603
        PICTURE.write_bytes(with_version((Path(work) / "report.png").read_bytes(), __version__))
    return 0


if __name__ == "__main__":
    sys.exit(main())
