"""The first five minutes of docs/vectors.md, with only a C compiler."""

from __future__ import annotations

import posixpath
import re
import subprocess
from pathlib import Path

import pytest

from tools.release import archive, c_files, vector_files

PAGE = Path(__file__).parents[2] / "docs" / "vectors.md"


@pytest.mark.tool("cc", "xxd")
def test_the_first_five_minutes(tmp_path: Path) -> None:
    text = PAGE.read_text(encoding="utf-8").partition("## Runners")[0]
    (version,) = set(re.findall(r"dcp-vectors-([\d.]+)\.tar", text))
    for name, content in (("vectors", vector_files(["dcp-2.0"])), ("c", c_files(["dcp-2.0"]))):
        top = f"dcp-{name}-{version}"
        archive(tmp_path / f"{top}.tar.gz", top, content, 0)
    blocks = re.findall(r"```(c?)\n(.*?)```", text, re.DOTALL)
    (tmp_path / "first.c").write_text(next(block for language, block in blocks if language == "c"))
    shown = "".join(block for language, block in blocks if not language and block.startswith("$"))
    commands = [line[2:] for line in shown.splitlines() if line.startswith("$ ")]
    printed = [line for line in shown.splitlines() if not line.startswith("$ ")]
    script = "set -e\n" + "\n".join(commands)
    found = subprocess.run(
        ["bash", "-c", script], cwd=tmp_path, env={"PATH": "/usr/bin:/bin"}, capture_output=True, text=True
    )
    assert found.returncode == 0, found.stderr
    assert found.stdout.splitlines() == printed


def test_links_lead_to_files_of_the_archive() -> None:
    found = c_files(["dcp-2.0"])
    links = 0
    for page in (name for name in found if name.endswith(".md")):
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", found[page].decode()):
            if "://" not in link:
                links += 1
                assert posixpath.normpath(posixpath.join(posixpath.dirname(page), link)) in found, f"{page}: {link}"
    assert links >= 4
