"""Run tests with other versions of Python, or with the lowest versions of the dependencies that pyproject.toml allows.

``python -m tools.versions`` (``make test-versions``) takes every Python from 3.11 to 3.14 on this machine, and names
those that are missing. ``--lowest`` (``make test-lowest``) takes the oldest of them with the lowest versions of the
direct dependencies. Each gets a virtual environment in ``build/versions``. Arguments after ``--`` go to pytest.

Exit status: 0 all passed; 1 tests failed, or an environment could not be made; 2 wrong usage, or uv is not there.
"""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
VERSIONS = ("3.11", "3.12", "3.13", "3.14")
#: Tests that need neither a network nor real time.
PARTS = ("--part=core", "--part=suite", "--part=tools", "--part=tables")
TESTS = ("-q", "-p", "no:cacheprovider", *PARTS, "tests/codec", "tests/stack", "tests/spec")
#: The distributions that are installed, with all that tests need.
PROJECTS = (".[test]", "./lab[plot]", "./tables[dask,duckdb,report]", "./selftest")


def interpreter(uv: str, version: str) -> Path | None:
    """Return a Python of this version that runs, None if there is none on this machine."""
    for folder in (Path.home() / ".pyenv" / "versions").glob(f"{version}.*"):
        if (folder / "bin" / "python").exists():
            return folder / "bin" / "python"
    command = [uv, "python", "find", "--no-project", "--no-python-downloads", version]
    found = subprocess.run(command, capture_output=True, text=True, check=False, cwd="/")  # noqa: S603 - uv itself
    return Path(found.stdout.strip()) if found.returncode == 0 else None


def environment(uv: str, python: Path, folder: Path, options: Sequence[str]) -> bool:
    """Make a virtual environment with this project and its tests; returns whether that worked."""
    projects = [part for each in PROJECTS for part in ("-e", each)]
    commands = (
        [uv, "venv", "--quiet", "--clear", "--python", str(python), str(folder)],
        [uv, "pip", "install", "--quiet", "--python", str(folder / "bin" / "python"), *options, *projects],
    )
    return all(subprocess.run(each, check=False, cwd=ROOT).returncode == 0 for each in commands)  # noqa: S603 - as above


def passed(folder: Path, tests: Sequence[str]) -> bool:
    """Run pytest in an environment; returns whether all tests passed."""
    variables = {**os.environ, "PYTHONHASHSEED": "0"}
    command = [str(folder / "bin" / "python"), "-m", "pytest", *tests]
    return subprocess.run(command, check=False, cwd=ROOT, env=variables).returncode == 0  # noqa: S603 - as above


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the tests; returns the exit status."""
    parser = argparse.ArgumentParser(prog="python -m tools.versions", description=(__doc__ or "").partition("\n\n")[0])
    parser.add_argument("--lowest", action="store_true", help="the lowest versions of direct dependencies")
    parser.add_argument("--python", action="append", metavar="VERSION", help="only this version, as 3.12; repeatable")
    parser.add_argument("tests", nargs="*", help="arguments of pytest")
    given = parser.parse_args(arguments)
    uv = shutil.which("uv", path=f"{Path(sys.executable).parent}{os.pathsep}{os.environ.get('PATH', '')}")
    if uv is None:
        print("uv is not installed: pip install uv", file=sys.stderr)
        return 2
    found = {version: interpreter(uv, version) for version in given.python or VERSIONS}
    there = {version: path for version, path in found.items() if path is not None}
    if not there:
        print(
            f"none of Python {', '.join(found)} is on this machine: uv python install {next(iter(found))}",
            file=sys.stderr,
        )
        return 2
    if given.lowest:
        there = dict(list(there.items())[:1])
    results = {}
    for version, python in there.items():
        name = f"{version}-lowest" if given.lowest else version
        folder = ROOT / "build" / "versions" / name
        print(f"Python {name}: {python}", flush=True)
        options = ["--resolution", "lowest-direct"] if given.lowest else []
        made = environment(uv, python, folder, options)
        results[name] = "not installed" if not made else "passed" if passed(folder, given.tests or TESTS) else "failed"
    for version in found:
        if found[version] is None:
            results[version] = "not on this machine"
    for name, result in results.items():
        print(f"Python {name:12} {result}")
    return 1 if {"failed", "not installed"} & set(results.values()) else 0


if __name__ == "__main__":
    sys.exit(main())
