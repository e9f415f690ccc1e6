"""The documentation site: it builds without warnings, loads nothing from elsewhere, and its search works from files."""

from __future__ import annotations

import re
from pathlib import Path

import dcp_conformance
import msgspec
import pytest
from dcp_conformance.definitions.pics import Capabilities, Target, Testing
from dcp_spec.catalogue.readings import readings
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.profile.loading import profile_names

import dcp_codec
import dcp_stack
from dcp_codec.codec import Codec

pytest.importorskip("zensical", reason="zensical is not installed (pip install 'dcp-conformance-kit[docs]')")
from tools.docs import __main__ as docs
from tools.docs.commands import COMMANDS
from tools.docs.figures import boxes, figure, records
from tools.docs.staging import with_links

from ..browser import Browser

pytestmark = pytest.mark.part("tools")

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def work(tmp_path_factory) -> Path:
    return tmp_path_factory.mktemp("docs")


@pytest.fixture(scope="module")
def site(work) -> Path:
    assert docs.build(work, work / "html") == 0
    return work / "html"


@pytest.fixture(scope="module")
def pages(site, work) -> Path:
    """The Markdown of the site."""
    return work / "docs"


def test_the_site_has_every_page_and_each_is_in_the_navigation(site, pages):
    made = {path.relative_to(pages).with_suffix(".html") for path in pages.rglob("*.md")}
    assert {path.relative_to(site) for path in site.rglob("*.html")} >= made
    navigation = docs.CONFIG.read_text(encoding="utf-8")
    assert [path for path in made if f'"{path.with_suffix(".md").as_posix()}"' not in navigation] == []


def test_nothing_is_loaded_from_elsewhere(site):
    assert docs.loaded_from_elsewhere(site) == []


@pytest.mark.parametrize(
    "text",
    [
        '<script src="https://unpkg.com/x"></script>',
        '<link rel="stylesheet" href="//fonts.example/css">',
        "<style>@font-face { src: url(https://fonts.example/a.woff2) }</style>",
    ],
)
def test_references_to_external_resources_are_found(text, tmp_path):
    (tmp_path / "index.html").write_text(text + '<a href="https://example.org/">a link to click</a>')
    assert len(docs.loaded_from_elsewhere(tmp_path)) == 1


@pytest.mark.tool("chromium")
def test_search_works_from_files(site, tmp_path):
    with Browser(tmp_path) as browser:
        browser.open(site / "glossary.html")
        browser.run("document.querySelector('.md-search__button').click()")
        # The dialogue is in a shadow tree, and its field has the focus once it is open.
        roots = "[...document.querySelectorAll('*')].map(each => each.shadowRoot).filter(each => each)"
        browser.wait(f"{roots}.some(root => root.activeElement && root.activeElement.matches('input'))")
        browser.call("Input.insertText", text="BP-RX-15")
        link = """root.querySelector('a[href*="requirements.html"][href$="#bp-rx-15"]')"""
        browser.wait(f"{roots}.some(root => {link})")
        assert [each for each in browser.requests if not each.startswith(("file:", "about:", "data:", "blob:"))] == []


def test_the_reference_of_commands_has_every_subcommand_and_option(pages):
    for line in COMMANDS:
        text = (pages / "reference" / f"{line.name}.md").read_text(encoding="utf-8")
        group = line.group()
        for name in line.subcommands:
            assert f"## `{line.name} {name}`" in text
            command = group.get_command(None, name)
            for option in getattr(command, "params", ()):
                if option.opts[0].startswith("--") and not option.hidden:
                    assert option.opts[0] in text


def test_the_reference_of_pics_has_every_key_with_a_default_or_none(pages):
    text = (pages / "reference" / "pics.md").read_text(encoding="utf-8")
    for struct in (Target, Capabilities, Testing):
        for field in msgspec.structs.fields(struct):
            assert f"| `{field.encode_name}` |" in text
    assert "| `beacon_period_ms` | number above 0 to 1e+09 | `100.0` |" in text


def test_the_reference_of_python_has_every_public_name(pages):
    text = (pages / "reference" / "python.md").read_text(encoding="utf-8")
    for package in (dcp_codec, dcp_stack, dcp_conformance):
        for name in package.__all__:
            assert f"### {package.__name__}.{name}\n" in text


def test_requirements_and_readings_are_complete(pages):
    text = (pages / "reference" / "requirements.md").read_text(encoding="utf-8")
    assert re.findall(r"^### (\S+)$", text, re.MULTILINE) == sorted(requirements(), key=list(requirements()).index)
    text = (pages / "reference" / "readings.md").read_text(encoding="utf-8")
    assert set(re.findall(r"^### (\S+)$", text, re.MULTILINE)) == set(readings())


@pytest.mark.parametrize("name", profile_names())
def test_figures_show_every_octet_of_fixed_records(name):
    for group in records(Codec(name)):
        fields = list(boxes(group))
        if group.size is not None:
            assert sum(box.size for box in fields) == group.size
        drawn = figure(group)
        assert all(f"<title>{box.name}: " in drawn for box in fields)


def test_links_lead_to_pages_and_other_files_are_shown_as_text():
    places = {"docs/ci.md": "ci.md", "README.md": "index.md"}
    assert with_links("[jobs](docs/ci.md#jobs)", "README.md", "index.md", places) == "[jobs](ci.md#jobs)"
    nested = with_links("[![x](docs/a.png)](docs/ci.md)", "README.md", "index.md", places | {"docs/a.png": "a.png"})
    assert nested == "[![x](a.png)](ci.md)"
    assert with_links("[home](../README.md)", "docs/ci.md", "ci.md", places) == "[home](index.md)"
    assert with_links("[code](../x/y.py)", "docs/ci.md", "ci.md", places) == "code (`x/y.py`)"
    assert with_links("```\n[code](../x/y.py)\n```", "docs/ci.md", "ci.md", places) == "```\n[code](../x/y.py)\n```"
