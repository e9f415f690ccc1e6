"""Make the documentation site: ``python -m tools.docs`` writes ``site/``; open ``site/index.html`` in a browser."""

from __future__ import annotations

import argparse
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path

from dcp_spec.profile.loading import load_profile, profile_names

from dcp_codec.codec import Codec
from dcp_codec.export.markdown import format_tables

from .catalogue import readings_page, requirements_page
from .commands import COMMANDS, command_page
from .figures import wire_page
from .markdown import page, table
from .python_api import python_page
from .schemas import schemas, schemas_page
from .staging import stage
from .structs import pics_page

ROOT = Path(__file__).resolve().parents[2]
CONFIG = Path(__file__).with_name("zensical.toml")
_SHIM = "https://unpkg.com/iframe-worker/shim"
#: References that a browser loads by itself: sources, style sheets, icons and fonts; not links to click.
_LOADS = re.compile(
    r"""\bsrc(?:set)?=["']?(?:https?:)?//[^"'\s>]+|<link\b(?![^>]*rel=["']?(?:canonical|next|prev|alternate))[^>]*href=["']?"""
    r"""(?:https?:)?//[^"'\s>]+|url\(["']?(?:https?:)?//[^)]+|@import\s+["'](?:https?:)?//[^"']+"""
)


def write_pages(target: Path) -> None:
    """Write all pages of the site as Markdown below ``target``, which is emptied before."""
    stage(ROOT, target)
    reference = target / "reference"
    wire = reference / "wire"
    wire.mkdir(parents=True)
    pages = {
        "pics.md": pics_page(),
        "schemas.md": schemas_page(ROOT),
        "python.md": python_page(ROOT),
        "requirements.md": requirements_page(ROOT),
        "readings.md": readings_page(),
        **{f"{line.name}.md": command_page(line) for line in COMMANDS},
    }
    for name, text in pages.items():
        (reference / name).write_text(text, encoding="utf-8")
    for name, (_, schema) in schemas(ROOT).items():
        (reference / name).write_text(json.dumps(schema, indent=2) + "\n", encoding="utf-8")
    rows = []
    for name in profile_names():
        codec = Codec(name)
        (wire / f"{name}.md").write_text(wire_page(codec, format_tables(codec)), encoding="utf-8")
        rows.append((f"[`{name}`]({name}.md)", load_profile(name).title))
    about = (
        "A wire profile describes the octets of one version of the specification, or of one implementation. Each page "
        "has a figure and a table of every record. `dcp-codec export markdown -p FILE` writes such tables for a "
        "profile of your own."
    )
    (wire / "index.md").write_text(page("Wire formats", about, table(("Profile", "Title"), rows)), encoding="utf-8")
    shutil.copytree(Path(__file__).with_name("assets"), target / "assets")


def build(work: Path, site: Path) -> int:
    """Stage the pages in ``work`` and build the site in ``site``; a warning, as of a broken link, is an error.

    Returns the exit status of Zensical.
    """
    write_pages(work / "docs")
    text = CONFIG.read_text(encoding="utf-8")
    # Paths in the configuration are relative to it.
    config = work / "zensical.toml"
    config.write_text(text, encoding="utf-8")
    shutil.rmtree(site, ignore_errors=True)
    status = subprocess.run(  # noqa: S603 - our own interpreter
        [sys.executable, "-m", "zensical", "build", "--clean", "--strict", "--config-file", str(config)], check=False
    ).returncode
    if (work / "site").is_dir():
        without_network(work / "site")
        shutil.move(work / "site", site)
    return status


def without_network(site: Path) -> None:
    """Let the pages load a script of the site where Zensical's offline plugin names one of a server."""
    for path in site.rglob("*.html"):
        text = path.read_text(encoding="utf-8")
        up = "../" * (len(path.relative_to(site).parts) - 1)
        path.write_text(text.replace(_SHIM, f"{up}assets/worker.js"), encoding="utf-8")


def loaded_from_elsewhere(site: Path) -> list[str]:
    """Return every address that a page or a style sheet of the site would load from a server."""
    found = set[str]()
    for path in site.rglob("*"):
        if path.suffix in (".html", ".css", ".svg"):
            text = path.read_text(encoding="utf-8")
            found.update(match[0] for match in _LOADS.finditer(text))
    return sorted(found)


def main() -> None:
    """Build the site where the command line says."""
    parser = argparse.ArgumentParser(prog="python -m tools.docs", description=__doc__)
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "docs", help="folder for the staged pages")
    parser.add_argument("--site", type=Path, default=ROOT / "site", help="folder of the site; it is replaced")
    given = parser.parse_args()
    given.work.mkdir(parents=True, exist_ok=True)
    sys.exit(build(given.work.resolve(), given.site.resolve()))


if __name__ == "__main__":
    main()
