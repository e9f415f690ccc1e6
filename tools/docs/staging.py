"""Stage the pages of the site: documents of the repository at their place in the site, with links that fit there."""

from __future__ import annotations

import posixpath
import re
import shutil
from pathlib import Path

#: Document of the repository -> page of the site; all of docs/ goes to the top.
DOCUMENTS = {
    "README.md": "index.md",
    "ARCHITECTURE.md": "architecture.md",
    "CONTRIBUTING.md": "contributing.md",
    "CHANGELOG.md": "changelog.md",
    "conformance/UPPER-TESTER.md": "upper-tester.md",
    "examples/base-station/README.md": "base-station.md",
}
_LINK = re.compile(r"(!?)\[((?:[^\[\]]|\[[^\]]*\])*)\]\(([^)\s]+)\)")
_FENCE = re.compile(r"^(```.*?^```)", re.MULTILINE | re.DOTALL)


def stage(root: Path, target: Path) -> None:
    """Write all documents below ``target``, which is emptied before."""
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    places = dict(DOCUMENTS)
    for path in sorted((root / "docs").iterdir()):
        if path.suffix == ".md":
            places[f"docs/{path.name}"] = path.name
        elif path.is_file():
            shutil.copy(path, target / path.name)
            places[f"docs/{path.name}"] = path.name
    for source, page in places.items():
        if page.endswith(".md"):
            text = (root / source).read_text(encoding="utf-8")
            (target / page).write_text(with_links(text, source, page, places), encoding="utf-8")


def with_links(text: str, source: str, page: str, places: dict[str, str]) -> str:
    """Return a document with its links changed; a link to a file that is not a page becomes the name of the file."""

    def changed(match: re.Match[str]) -> str:
        image, label, link = match.groups()
        # The label may be an image, which is a link itself.
        label = _LINK.sub(changed, label)
        path, _, anchor = link.partition("#")
        if "://" in link or link.startswith("mailto:") or not path:
            return f"{image}[{label}]({link})"
        found = posixpath.normpath(posixpath.join(posixpath.dirname(source), path))
        if found not in places:
            return label if label.strip("`").endswith(posixpath.basename(found)) else f"{label} (`{found}`)"
        there = posixpath.relpath(places[found], posixpath.dirname(page) or ".")
        return f"{image}[{label}]({there}{'#' + anchor if anchor else ''})"

    pieces = _FENCE.split(text)
    return "".join(piece if piece.startswith("```") else _LINK.sub(changed, piece) for piece in pieces)
