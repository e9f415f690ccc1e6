"""References in documents exist: files and headings that they link to, commands and options, cases and mutants."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from dcp_conformance.cli import main as conformance
from dcp_conformance.definitions.case import all_cases
from dcp_selftest.cli import main as selftest
from dcp_selftest.mutants import all_mutants

from dcp_codec.cli import main as codec
from dcp_stack.cli import main as node

ROOT = Path(__file__).parents[2]
#: Written by people; the others are made by commands, and those who make them are tested.
DOCUMENTS = sorted(
    path
    for path in (
        *ROOT.glob("*.md"),
        *ROOT.glob("docs/*.md"),
        *ROOT.glob("examples/*/*.md"),
        *ROOT.glob("conformance/*.md"),
    )
    if path.name not in ("traceability.md", "selftest.md")
)
GROUPS = {each.name: each.group() for each in (codec, node, conformance, selftest)}
#: A typed command, up to the end of the line, a comment or the next command.
_COMMAND = re.compile(r"(?:^|[ `(])((?:dcp-codec|dcp-node|dcp-conformance|dcp-selftest) [^#|`\n]*)", re.MULTILINE)
_LINK = re.compile(r"\]\(([^)\s]+)\)")
_CASE = re.compile(r"\bTC_[A-Z][\w.*-]*")
_MUTANT = re.compile(r"\bM-[A-Z]+-[A-Z]+-\d\d-[a-zA-Z*-]+")

each_document = pytest.mark.parametrize("path", DOCUMENTS, ids=lambda path: str(path.relative_to(ROOT)))


def headings(text: str) -> set[str]:
    """The anchors that a reader of the text on the web gets."""
    return {re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-") for each in re.findall(r"^#+ (.*)$", text, re.M)}


def resolved(words: list[str]) -> tuple[click.Command, list[str]]:
    """The command that the words name, and what it is given."""
    command: click.Command = GROUPS[words[0]]
    rest = words[1:]
    while isinstance(command, click.Group) and rest:
        found = command.get_command(click.Context(command), rest[0])
        if found is None:
            break
        command, rest = found, rest[1:]
    return command, rest


def options(words: list[str]) -> Iterator[str]:
    for word in words:
        if match := re.match(r"\[?(--?[a-z][a-z-]*)", word):
            yield match[1]


@each_document
def test_links_lead_somewhere(path: Path):
    for link in _LINK.findall(path.read_text(encoding="utf-8")):
        if link.startswith("https://"):
            continue
        name, _, anchor = link.partition("#")
        target = path.parent / name if name else path
        assert target.exists(), link
        assert not anchor or anchor in headings(target.read_text(encoding="utf-8")), link


@each_document
def test_options_of_commands_exist(path: Path):
    for typed in _COMMAND.findall(path.read_text(encoding="utf-8")):
        command, rest = resolved(typed.split())
        known = {each for parameter in command.params for each in (*parameter.opts, *parameter.secondary_opts)}
        missing = set(options(rest)) - known - {"--help", "--version"}
        assert not missing, typed


@each_document
def test_commands_in_documents_name_a_subcommand(path: Path):
    for line in path.read_text(encoding="utf-8").splitlines():
        if match := re.match(r"(?:\$ )?((?:dcp-codec|dcp-node|dcp-conformance|dcp-selftest) [a-z].*)", line):
            command, _ = resolved(match[1].split())
            # The words after the name of a group are prose, not a command.
            assert not isinstance(command, click.Group), line


@each_document
def test_cases_and_mutants_exist(path: Path):
    text = path.read_text(encoding="utf-8")
    known = set(all_cases()) | {case.base for case in all_cases().values()}
    assert not [name for name in known if name.endswith("_99")]
    for name in set(_CASE.findall(text)) - retired():
        # Cases of findings are made when they are run. Examples have the number 99, which no case of the suite has.
        if not name.startswith("TC_DCP_FUZZ_") and not name.endswith("_99"):
            assert fnmatch.filter(known, name.rstrip(".-")), name
    for name in _MUTANT.findall(text):
        assert fnmatch.filter(all_mutants(), name), name


def retired() -> set[str]:
    ledger = ROOT / "conformance" / "dcp_conformance" / "data" / "case-ids.txt"
    return {line.split()[0] for line in ledger.read_text(encoding="utf-8").splitlines() if line.endswith(" retired")}
