"""The commands of docs/vectors.md, in a folder with the archives of a release: first with only a C compiler."""

from __future__ import annotations

import posixpath
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from dcp_spec.version import __version__

from tools.release import archive, c_files, vector_files

PAGE = (Path(__file__).parents[2] / "docs" / "vectors.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the two archives of a release."""
    found = tmp_path_factory.mktemp("page")
    for name, content in (("vectors", vector_files(["dcp-2.0"])), ("c", c_files(["dcp-2.0"]))):
        top = f"dcp-{name}-{__version__}"
        archive(found / f"{top}.tar.gz", top, content, 0)
    return found


def shown(text: str) -> tuple[list[str], list[str]]:
    """The commands of a part of the page, and what they print."""
    blocks = re.findall(r"```\n(\$.*?)```", text, re.DOTALL)
    lines = "".join(blocks).splitlines()
    return [line[2:] for line in lines if line.startswith("$ ")], [line for line in lines if not line.startswith("$ ")]


def run(commands: list[str], folder: Path, path: str) -> str:
    script = "set -e\n" + "\n".join(commands)
    done = subprocess.run(["bash", "-c", script], cwd=folder, env={"PATH": path}, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr
    return done.stdout


@pytest.mark.tool("cc", "xxd")
def test_the_first_five_minutes(folder: Path) -> None:
    text = PAGE.partition("## Runners")[0]
    (folder / "first.c").write_text(re.findall(r"```c\n(.*?)```", text, re.DOTALL)[0])
    commands, printed = shown(text)
    assert run(commands, folder, "/usr/bin:/bin").splitlines() == printed


@pytest.mark.tool("cc", "g++", "rustc")
@pytest.mark.skipif(not Path("/usr/include/gtest").is_dir(), reason="needs libgtest-dev")
def test_runners_in_cpp_python_and_rust(folder: Path) -> None:
    unpack, names = shown(PAGE)[0][:2]
    commands, _ = shown(PAGE.partition("## Runners")[2])
    rust = Path(shutil.which("rustc") or "").parent
    printed = run([unpack, names, *commands], folder, f"{Path(sys.executable).parent}:{rust}:/usr/bin:/bin")
    counts = re.findall(r"^(\d+) vectors, 0 failed$", PAGE, re.MULTILINE)
    assert re.findall(r"\[  PASSED  \] (\d+) tests", printed) == counts
    assert f"{sum(map(int, counts))} passed" in printed
    assert f"{counts[0]} vectors, 0 failed\n" in printed


def test_links_lead_to_files_of_the_archive() -> None:
    found = c_files(["dcp-2.0"])
    links = 0
    for page in (name for name in found if name.endswith(".md")):
        for link in re.findall(r"\]\(([^)#]+)[^)]*\)", found[page].decode()):
            if "://" not in link:
                links += 1
                assert posixpath.normpath(posixpath.join(posixpath.dirname(page), link)) in found, f"{page}: {link}"
    assert links >= 4
