"""A check of the English in docstrings, comments and messages: expressions that a reader has to decipher.

``PATTERNS`` gives each expression with the reason and the better wording. ``python tests/meta/prose.py`` prints the
number of hits in each package, and ``python tests/meta/prose.py PATH...`` every hit in some folders or files.
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
#: The packages that are checked, relative to the repository.
FOLDERS = ("spec/dcp_spec", "dcp_codec", "dcp_stack", "conformance/dcp_conformance")


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
    Pattern(
        r"(?<!there )\b(?:is|are|was|were) no (?!longer|more)",
        "'is not a ...'",
    ),
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
    Pattern(r"^(?:how (?:many|often)|(?:in|by) how many|under which)\b[^?]*$", "name the quantity: 'Number of ...'"),
    Pattern(
        r"^nothing is (?:held|ever lost)\b|^from now on it is\b", "name the effect: 'Has no effect: ...', 'Mark ...'"
    ),
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
    """Return the hits in a file, or in the Python files of a folder."""
    root = ROOT / name
    files = [root] if root.is_file() else sorted(root.rglob("*.py"))
    return [hit for each in files for hit in hits(each)]


def main(folders: list[str]) -> int:
    """Print hits, or their number in each package; return 1 if there are any."""
    for folder in folders:
        print(*hits_in(folder), sep="\n")
    if folders:
        return 0
    bad = 0
    for folder in FOLDERS:
        count = len(hits_in(folder))
        bad += count
        print(f"{count:5}  {folder}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
