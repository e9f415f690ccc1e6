"""docs/profile-reference.md is what the types say, and its examples can be used."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_spec.profile.loading import load_profile
from dcp_spec.profile.reference import EXAMPLES, reference

from dcp_codec import Codec
from dcp_codec.export.example import example_beacon

PAGE = Path(__file__).resolve().parents[2] / "docs" / "profile-reference.md"


def test_the_page_is_up_to_date() -> None:
    advice = "python -m dcp_spec.profile.reference docs/profile-reference.md writes it"
    assert PAGE.read_text(encoding="utf-8") == reference(), advice


def test_every_key_has_a_meaning() -> None:
    rows = [line.split(" | ") for line in reference().splitlines() if line.startswith("| `")]
    assert len(rows) > 80
    assert [row[0] for row in rows if len(row[-1].strip(" |")) < 5] == []


@pytest.mark.parametrize("key", EXAMPLES)
def test_every_example_is_a_profile(key: str, tmp_path: Path) -> None:
    text = EXAMPLES[key][1].strip()
    base = "" if text.startswith("extends") else 'extends = "dcp-2.0"\nname = "mine"\n'
    path = tmp_path / "mine.toml"
    path.write_text(base + text, encoding="utf-8")
    codec = Codec(load_profile(path))
    assert codec.profile != load_profile("dcp-2.0")
    octets = codec.encode(example_beacon(codec))
    assert codec.encode(codec.decode(octets)) == octets
    assert codec.dissect(octets).problems == []
