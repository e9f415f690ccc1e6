"""A check of the English in docstrings, comments and messages: expressions that a reader has to decipher.

``PATTERNS`` gives each expression with the reason and the better wording. Folders and files in ``DONE`` must be free of
them; folders in ``TO_DO`` have not been revised yet and are only counted. Move a folder from ``TO_DO`` to ``DONE``
after its revision, or add a file of it to ``DONE``. ``python tests/meta/prose.py`` prints the number of hits in each of
them, and ``python tests/meta/prose.py PATH...`` every hit in some.
"""

from __future__ import annotations

import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
_SUITE = "conformance/dcp_conformance"

#: Folders and files without any hit, relative to the repository.
DONE = (
    f"{_SUITE}/sut",
    f"{_SUITE}/interconnection",
    f"{_SUITE}/check",
    f"{_SUITE}/model",
    f"{_SUITE}/passive",
    f"{_SUITE}/provenance",
    f"{_SUITE}/reference",
    f"{_SUITE}/oracle",
    f"{_SUITE}/lower_tester",
    f"{_SUITE}/upper_tester",
    f"{_SUITE}/reporting",
    f"{_SUITE}/diagnosis",
    f"{_SUITE}/fuzz",
    "spec/dcp_spec",
    "dcp_codec",
    f"{_SUITE}/suite",
    f"{_SUITE}/selftest",
    f"{_SUITE}/cli",
    f"{_SUITE}/execution",
    f"{_SUITE}/frames",
    f"{_SUITE}/impairment",
    f"{_SUITE}/__init__.py",
    f"{_SUITE}/errors.py",
    f"{_SUITE}/pytest_plugin.py",
    f"{_SUITE}/traceability.py",
    f"{_SUITE}/test_steps",
    f"{_SUITE}/test_system",
    "dcp_stack/__init__.py",
    "dcp_stack/bp_port.py",
    "dcp_stack/config.py",
    "dcp_stack/drops.py",
    "dcp_stack/effects.py",
    "dcp_stack/node.py",
    "dcp_stack/own_fields.py",
    "dcp_stack/record_sizes.py",
    "dcp_stack/timestamps.py",
    "dcp_stack/bp",
    "dcp_stack/srp",
    "dcp_stack/links",
    "dcp_stack/runtime",
    "dcp_stack/control",
    "dcp_stack/cli",
    "dcp_stack/vardis",
    "dcp_stack/sim",
    "dcp_stack/positions",
    "dcp_stack/relay",
    "dcp_stack/neighbour_file",
)
#: Folders that still have to be revised; their hits are counted.
TO_DO = (
    _SUITE,
    "dcp_stack",
)


@dataclass(frozen=True)
class Pattern:
    """An expression to be avoided."""

    expression: str
    """A regular expression for the text in lower case, without line breaks."""
    reason: str
    """Why it is hard to read, or what to write instead."""


PATTERNS = (
    Pattern(r"\bbehind\b", "'after' for time and order"),
    Pattern(r"\bin front of\b", "'before' for time and order"),
    Pattern(r"\bahead of its\b", "'before' for time and order"),
    Pattern(r"\bone (?:behind|after) the other\b", "'in succession', or 'each after the one before'"),
    Pattern(
        r"\b(?:is|are|was|were|be|been) (?:told|said)\b(?! (?:from|apart))",
        "name the message: 'is reported', 'is sent', 'the answer has'",
    ),
    Pattern(r"\btells? (?:of|nobody|clients|that)\b", "name the message: 'reports', 'indicates', 'returns'"),
    Pattern(r"\bsays? (?:so|of|nothing|that it|ok)\b", "'answers', 'returns', 'has the value'"),
    Pattern(
        r"\bso (?:many|much) (?:\w+ )?(?:together|in all|of a kind|octets|periods|beacons)\b",
        "give the number: 'n octets'",
    ),
    Pattern(r"\bas (?:ever|often as ever)\b", "name the state it is compared with: 'as while BP is active'"),
    Pattern(
        r"\bwho(?:ever)? (?:has|have|is|asks|loses|lost|missed|sends|wants|did|breaks|knows|looks|cannot)\b",
        "name the subject: 'an implementation that ...', 'if the user ...'",
    ),
    Pattern(r"\b(?:nobody|somebody|everybody|anybody)\b", "name the node, client or user; 'an unregistered protocol'"),
    Pattern(r"\bof nobody\b", "'of an unregistered protocol', 'of an unknown client'"),
    Pattern(r"\bstands? (?:in|at|before|first|behind|there|twice)\b", "'is', 'has the position'"),
    Pattern(r"\bgoes? on\b|\bgoing on\b|\bgo on\b", "'continues'"),
    Pattern(r"\banew\b", "'again'; a timeout 'restarts'"),
    Pattern(r"\b(?:takes?|taken|took) (?:back|for)\b", "'cancels', 'treats as'"),
    Pattern(
        r"\b(?:passes|passed|pass|sends|sent|handed|hands|hand) (?:it |them |that |something )?(?:on|down)\b(?! the)",
        "'forwards', 'submits'",
    ),
    Pattern(r"\bhand-downs?\b", "'submission of safety data'"),
    Pattern(r"\b(?:dies|died|die) of\b", "'crashes on'"),
    Pattern(r"\b(?:becomes|become|became) of\b", "name the reaction: 'Is it processed?'"),
    Pattern(r"\blooks? at\b|\blooked at\b", "'checks', 'processes', 'reads'"),
    Pattern(r"\bon (?:its|their) own account\b|\bon account of\b", "'by itself', 'as a reaction to'"),
    Pattern(r"\bin vain\b", "'without success'"),
    Pattern(
        r"^(?:what|who|whose|those|they|whatever|whoever)\b[^?]*$",
        "start with a verb or a noun phrase: 'Return ...', 'The fields ...'",
    ),
    Pattern(r"^(?:none|nothing|all|both) (?:of (?:it|them)|there)\b", "name the subject"),
    Pattern(r"\bso that (?:who|what)\b|\bthe truth\b|\bhonestly\b", "name the subject"),
    Pattern(r"\bnothing but\b|\bnone but\b|\ball but\b", "'only', 'except'"),
    Pattern(r"\bas (?:it|they) (?:is|are|was|were|came|should be)\b", "'unchanged', 'as received', 'as configured'"),
    Pattern(r"\b(?:least|most) significant octet first\b", "'little-endian', 'big-endian'"),
    Pattern(r"\bof (?:his|its|their|the tester's) own(?: [a-z]+)? (?:way|words)\b", "state what differs"),
    Pattern(r"\bin another way\b", "state what is changed: 'Changes the list of clients.'"),
    Pattern(r"\bhonest\b", "'valid' (beacon, payload)"),
    Pattern(r"\bspoilt\b", "'invalid', 'damaged'"),
    Pattern(r"\bword(?:s)? of\b|\bby name only\b", "name the field or message"),
    Pattern(r"^there (?:is|are) (?:none|one)\b", "name the missing object, or 'none in time'"),
    Pattern(r"\b(?:it|they) (?:is|are|does|do) not\b[.;:\"]?$", "repeat the verb: 'not indicated in time'"),
    Pattern(r"^(?:it|they) (?:is|are|does|do)\b[.;:\"]?$", "repeat the observation: 'an indication of it'"),
    Pattern(r"\b(?:is|are) no (?:number|beacon|name|hex|payload|dictionary|fault)\b", "'is not a ...'"),
    Pattern(r"\btime has run out\b", "'after its timeout'"),
    Pattern(r"\bonce more\b(?! than)", "'again'"),
    Pattern(r"\bmeanwhile\b(?!`)", "name the time: 'while BP is inactive'"),
    Pattern(r"\bwithout a word\b|\bwords at rest\b|\bthe air\b(?! interface)", "'without a message'; 'in the beacons'"),
)


@dataclass(frozen=True)
class Text:
    """A text that a person reads."""

    line: int
    text: str


@dataclass(frozen=True)
class Hit:
    """An expression to be avoided in a file."""

    path: Path
    line: int
    found: str
    pattern: Pattern

    def __str__(self) -> str:
        place = self.path.relative_to(ROOT) if self.path.is_relative_to(ROOT) else self.path
        return f"{place}:{self.line}: {self.found!r}; better: {self.pattern.reason}"


def texts(source: str) -> Iterator[Text]:
    """Yield docstrings, other strings with a space, and comments; adjacent comment lines are one text.

    The parts of an f-string between its expressions are joined with ``...``.
    """
    tree = ast.parse(source)
    parts_of_others = {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    for node in ast.walk(tree):
        if id(node) in parts_of_others:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, str) and " " in node.value:
            yield Text(node.lineno, node.value)
        elif isinstance(node, ast.JoinedStr):
            parts = (each.value if isinstance(each, ast.Constant) else "..." for each in node.values)
            yield Text(node.lineno, "".join(map(str, parts)))
    block: list[str] = []
    start = previous = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        if token.start[0] != previous + 1 and block:
            yield Text(start, " ".join(block))
            block = []
        if not block:
            start = token.start[0]
        block.append(token.string.lstrip("#: "))
        previous = token.start[0]
    if block:
        yield Text(start, " ".join(block))


def hits(path: Path) -> Iterator[Hit]:
    """Yield the hits in a Python file."""
    for text in texts(path.read_text("utf-8")):
        joined = " ".join(text.text.split())
        # A search in lower case is several times faster than one that ignores the case.
        lower = joined.lower()
        for pattern in PATTERNS:
            if found := re.search(pattern.expression, lower):
                yield Hit(path, text.line, joined[slice(*found.span())], pattern)


def hits_in(name: str) -> list[Hit]:
    """Return the hits in a file, or in the Python files of a folder except those that are listed separately."""
    root = ROOT / name
    listed = {each for each in (ROOT / other for other in (*DONE, *TO_DO)) if root in each.parents}
    files = [root] if root.is_file() else sorted(root.rglob("*.py"))
    return [hit for each in files if not listed.intersection((each, *each.parents)) for hit in hits(each)]


def main(folders: list[str]) -> int:
    """Print hits, or their number in each folder; return 1 if a revised folder has some."""
    for folder in folders:
        print(*hits_in(folder), sep="\n")
    if folders:
        return 0
    bad = 0
    for folder in (*DONE, *TO_DO):
        count = len(hits_in(folder))
        bad += count if folder in DONE else 0
        print(f"{count:5}  {folder}{'' if folder in DONE else ' (to do)'}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
