"""A check of the English in docstrings, comments, messages and names: expressions that a reader has to decipher.

``PATTERNS`` gives each expression with the reason and the better wording. ``python tests/meta/prose.py`` prints the
number of hits in each package, and ``python tests/meta/prose.py PATH...`` every hit in some folders or files.

A text that has to contain such an expression, such as output that a test expects, is exempt if ``# prose: data`` is in
one of its lines.
"""

from __future__ import annotations

import functools
import re
import sys
from bisect import bisect_right
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).parents[2]
#: The folders that are checked, relative to the repository.
FOLDERS = (
    "spec/dcp_spec",
    "dcp_codec",
    "dcp_stack",
    "conformance/dcp_conformance",
    "lab/dcp_lab",
    "tables/dcp_tables",
    "selftest/dcp_selftest",
    "tests",
    "tools",
    "benchmarks",
    "examples",
)
#: Files that list such expressions.
EXEMPT = frozenset({ROOT / "tests/meta/prose.py", ROOT / "tests/meta/test_prose.py"})
#: Exempts the text in whose lines it is.
MARKER = "# prose: data"


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


# One search for all of them: most texts have no hit. Each expression starts with a word.
ANY = re.compile(r"\b(?:" + "|".join(each.expression for each in PATTERNS) + ")")

# The syntax of Python as far as texts need it; several times faster than ``ast`` and ``tokenize``. Before Python 3.12
# an f-string cannot contain its own quotation mark.
TOKEN = re.compile(
    r"""
    (?P<comment>\#[^\n]*)
    | \b(?:def|class)[ ](?P<name>\w+)
    | (?P<prefix>\b[A-Za-z]{1,2})?(?P<quote>\"{3}|\'{3}|\"|\')(?P<body>(?:[^\\]|\\.)*?)(?P=quote)
    """,
    re.VERBOSE | re.DOTALL,
)
# An expression of an f-string, or a doubled brace.
FIELD = re.compile(r"\{\{|\}\}|\{((?:[^{}]|\{[^{}]*\})*)\}")
# Between two parts of one string or comment: no blank line.
BETWEEN = re.compile(r"[^\S\n]*\\?\n?[^\S\n]*")
# An escape sequence for white space.
ESCAPE = re.compile(r"\\[nrt\n]")
CAPITAL = re.compile(r"(?<=[a-z])(?=[A-Z])")


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
    """Yield docstrings, other strings with a space, comments, and names of functions and classes.

    Adjacent comment lines are one text, as are adjacent strings. Names are split into words, without ``test``. Each
    expression of an f-string becomes ``...``; the strings inside it are further texts. ``bytes`` are data.
    """
    ends = [found.end() for found in re.finditer("\n", source)]
    marked = {bisect_right(ends, found.start()) for found in re.finditer(re.escape(MARKER), source)}
    for kind, start, end, text in _joined(source):
        first, last = bisect_right(ends, start), bisect_right(ends, end)
        if (kind != "string" or " " in text.strip()) and marked.isdisjoint(range(first, last + 1)):
            yield Text(first + 1, text)


def _joined(source: str) -> Iterator[tuple[str, int, int, str]]:
    """Yield kind, start, end and text of what ``texts`` yields; adjacent comments and strings are joined."""
    kind, start, end, parts = "", 0, 0, list[str]()
    for found in TOKEN.finditer(source):
        if found["name"]:
            yield "name", *found.span(), _words(found["name"])
            continue
        if "b" in (found["prefix"] or "").lower():
            continue
        this = "comment" if found["comment"] else "string"
        if this != kind or not BETWEEN.fullmatch(source, end, found.start()):
            if parts:
                yield kind, start, end, "".join(parts)
            kind, start, parts = this, found.start(), []
        end = found.end()
        if this == "comment":
            parts.append(found["comment"].lstrip("#: ") + " ")
            continue
        body = found["body"]
        if "\\" in body and "r" not in (found["prefix"] or "").lower():
            body = ESCAPE.sub(" ", body)
        if "f" in (found["prefix"] or "").lower():
            for field in FIELD.findall(body):
                yield from ((each, *found.span(), text) for each, _, _, text in _joined(field))
            body = FIELD.sub("...", body)
        parts.append(body)
    if parts:
        yield kind, start, end, "".join(parts)


def _words(name: str) -> str:
    """Split the name of a function or class into words."""
    return CAPITAL.sub(" ", name).replace("_", " ").strip().removeprefix("test ")


def hits(path: Path) -> Iterator[Hit]:
    """Yield the hits in a Python file."""
    if path in EXEMPT:
        return
    for text in texts(path.read_text("utf-8")):
        joined = " ".join(text.text.split())
        # A search in lower case is several times faster than one that ignores the case.
        lower = joined.lower()
        if not ANY.search(lower):
            continue
        for pattern in PATTERNS:
            if found := re.search(pattern.expression, lower):
                yield Hit(path, text.line, joined[slice(*found.span())], pattern)


@functools.cache
def hits_in(name: str) -> list[Hit]:
    """Return the hits in a file, or in the Python files of a folder."""
    root = ROOT / name
    files = [root] if root.is_file() else sorted(root.rglob("*.py"))
    return [hit for each in files for hit in hits(each)]


def main(paths: list[str], folders: tuple[str, ...] = FOLDERS) -> int:
    """Print the hits in ``paths``, or the number of hits in each of the folders; return 1 if there are any."""
    for path in paths:
        print(*hits_in(path), sep="\n")
    if paths:
        return 0
    bad = 0
    for folder in folders:
        count = len(hits_in(folder))
        bad += count
        print(f"{count:5}  {folder}")
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
