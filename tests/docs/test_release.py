"""Picture, citation and archive names in the documents are of this version."""

from __future__ import annotations

import re
from pathlib import Path

import yaml
from dcp_spec.version import __version__

from tools.picture import PICTURE, version_of

ROOT = Path(__file__).resolve().parents[2]


def test_documents_are_of_this_version() -> None:
    assert version_of(PICTURE.read_bytes()) == __version__, "make picture"
    citation = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert citation["version"] == __version__
    archives = re.findall(r"dcp-(?:vectors|c)-(\d[\d.]*\d)", (ROOT / "docs" / "vectors.md").read_text(encoding="utf-8"))
    assert set(archives) == {__version__}
    assert f"## [{__version__}]" in (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
