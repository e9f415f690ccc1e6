"""The statements of a specification in Markdown: sentences, and steps of numbered pseudo-code.

A statement is told from others by a fingerprint of its normalised text. Typesetting, line breaks, link targets and the
number of a step are not part of it, so that only a change of wording changes it.
"""

from __future__ import annotations

import hashlib
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal

#: Hexadecimal digits of a fingerprint, and of a sketch.
FINGERPRINT_DIGITS: Final = 12
SKETCH_DIGITS: Final = 16

Kind = Literal["sentence", "step", "code", "heading"]

_FENCE = re.compile(r"^\s*(~~~+|```+)")
_HEADING = re.compile(r"^(#{1,6})\s+(.*?)\s*#*\s*(?:\{#([^}\s]+)[^}]*\})?\s*$")
_ITEM = re.compile(r"^(\s*)[-*+]\s+")
_NUMBERED = re.compile(r"^(\s*)(\d+)[.)]\s+")
#: In pseudo-code the full stop after the number is sometimes forgotten, and steps start at the left edge.
_STEP = re.compile(r"^(\d+(?:\.[a-z](?=[.)]))?)(?:[.)]\s*|\s+)(?=\S)")
_LINK = re.compile(r"\[([^\]]*)\]\([^)]*\)")
_END = re.compile(r"(?<=[.!?:])[)\"'*_`]*\s+(?=[\"'(*_`\[]*[A-Z0-9`])")
_ABBREVIATION = re.compile(r"(?:\b(?:e\.g|i\.e|c\.f|cf|etc|vs|resp|incl|no)|^[A-Z])\.$", re.IGNORECASE)
_NORMATIVE = re.compile(
    r"\b(?:must|shall|should|will|may|can|cannot|ha(?:s|ve) to|is to be|are to be|need(?:s|ed)?|required?|"
    r"requirements?|mandatory|optional|always|never|only|at (?:least|most)|exactly|no (?:more|less|larger|smaller)|"
    r"set to|initiali[sz]ed|default|guarantees?|dropped|discard(?:s|ed)?|ignored?|returns?|performs?|contains?|carries|"
    r"consists?|unsigned|bits?|bytes?|(?:is|are) not (?:allowed|permitted)|implementation-dependent)\b|\d",
    re.IGNORECASE,
)


@dataclass(frozen=True, slots=True)
class Statement:
    """A sentence or a step at its place in the specification."""

    file: str
    """Name of the file, without folders."""
    headings: tuple[str, ...]
    """Titles of the headings above it, outermost first."""
    anchor: str
    """Identifier of the innermost heading, empty if it has none."""
    line: int
    """Line of its first word, from 1."""
    kind: Kind
    """``step``: of numbered pseudo-code or a numbered list; ``code``: a line of other code."""
    step: str
    """Number of a step ("3", "3.d"), empty for anything else."""
    fingerprint: str
    sketch: str
    """Locality-sensitive hash: statements that have most words in common differ in few bits."""
    normative: bool
    """Whether it looks like a rule: a step, or words such as "must" or "at most", or a number."""
    text: str = ""
    """The wording, for messages about the file that was read. It is never stored; empty in the recorded baseline."""

    @property
    def heading(self) -> str:
        """The path of headings as one line."""
        return " > ".join(self.headings)

    @property
    def place(self) -> tuple[str, str]:
        """File and section, for comparisons between versions: the anchor where there is one."""
        return self.file, f"#{self.anchor}" if self.anchor else self.heading


def normalised(text: str) -> str:
    """Wording without typesetting: no emphasis, link targets, line breaks or final full stop, in lower case."""
    text = _LINK.sub(r"\1", text)
    text = text.replace("**", "").replace("`", "").replace("~", "")
    text = re.sub(r"(?<![\w*])[*_](?=\S)|(?<=\S)[*_](?![\w*])", "", text)
    return " ".join(text.split()).rstrip(".:;").casefold()


def fingerprint(text: str) -> str:
    """Fingerprint of a normalised text."""
    return hashlib.sha256(text.encode()).hexdigest()[:FINGERPRINT_DIGITS]


def sketch(text: str) -> str:
    """Simhash (64 bits, hexadecimal) of single words and word pairs in a normalised text."""
    words = re.findall(r"[^\W_]+|[^\w\s-]+", text)
    features = [*words, *(f"{left} {right}" for left, right in pairwise(words))]
    sums = [0] * 64
    for feature in features:
        bits = int.from_bytes(hashlib.sha256(feature.encode()).digest()[:8])
        for number in range(64):
            sums[number] += 1 if bits >> number & 1 else -1
    value = sum(1 << number for number, each in enumerate(sums) if each > 0)
    return f"{value:0{SKETCH_DIGITS}x}"


def distance(left: str, right: str) -> int:
    """Number of bits in which two sketches differ, 0 to 64; unrelated texts differ in about 32."""
    return (int(left, 16) ^ int(right, 16)).bit_count()


def statements(file: str, text: str) -> list[Statement]:
    """All statements of one Markdown file, from top to bottom."""
    return list(_Reader(file).read(text.splitlines()))


def _ends(text: str) -> Iterator[tuple[int, int]]:
    """Where a sentence may end, and where the next one starts."""
    return ((match.start(), match.end()) for match in _END.finditer(text))


def _line_of(position: int, starts: Iterable[tuple[int, int]]) -> int:
    return max(number for offset, number in starts if offset <= position)


class _Reader:
    """Splits a file into blocks (paragraphs, list items, steps) and those into statements."""

    def __init__(self, file: str) -> None:
        self._file = file
        self._headings: list[tuple[int, str]] = []
        self._anchor = ""

    def read(self, lines: Iterable[str]) -> Iterator[Statement]:
        block: list[tuple[int, str]] = []
        step = ""
        fence = ""
        code: list[tuple[int, str]] = []
        for number, raw in enumerate(lines, 1):
            line = raw.expandtabs(4).rstrip()
            if match := _FENCE.match(line):
                mark = match[1][0]
                if not fence:
                    yield from self._sentences(block, step)
                    block, step, fence = [], "", mark
                    continue
                if mark == fence:
                    yield from self._code(code)
                    code, fence = [], ""
                    continue
            if fence:
                code.append((number, line))
                continue
            heading = _HEADING.match(line)
            item, numbered = _ITEM.match(line), _NUMBERED.match(line)
            if heading or not line.strip() or line.strip() == "---" or item or numbered:
                yield from self._sentences(block, step)
                block, step = [], ""
            if heading:
                self._enter(len(heading[1]), heading[2], heading[3] or "")
                yield from self._statement(number, "heading", "", heading[2])
            elif numbered:
                step = numbered[2]
                block = [(number, line[numbered.end() :])]
            elif item:
                block = [(number, line[item.end() :])]
            elif line.strip() and line.strip() != "---":
                block.append((number, line))
        yield from self._sentences(block, step)
        yield from self._code(code)

    def _enter(self, level: int, title: str, anchor: str) -> None:
        self._headings = [each for each in self._headings if each[0] < level]
        self._headings.append((level, title.replace("`", "").strip()))
        self._anchor = anchor

    def _sentences(self, block: list[tuple[int, str]], step: str) -> Iterator[Statement]:
        text = ""
        starts: list[tuple[int, int]] = []
        for number, line in block:
            starts.append((len(text), number))
            text += line.strip() + " "
        kind: Kind = "step" if step else "sentence"
        begin = 0
        for end, following in _ends(text):
            if _ABBREVIATION.search(text[begin:end].rstrip(")\"'*_`")) or text[end - 1] == ":":
                continue
            yield from self._statement(_line_of(begin, starts), kind, step, text[begin:following])
            begin = following
        if text[begin:].strip():
            yield from self._statement(_line_of(begin, starts), kind, step, text[begin:])

    def _code(self, lines: list[tuple[int, str]]) -> Iterator[Statement]:
        """Numbered steps with what belongs to each; every line of code before the first step, or without steps."""
        current: list[tuple[int, str]] = []
        step = ""
        for number, line in lines:
            match = _STEP.match(line)
            if match is None and step:
                if line.strip():
                    current.append((number, line))
                continue
            if step:
                yield from self._statement(current[0][0], "step", step, " ".join(each for _, each in current))
            if match is not None:
                step, current = match[1], [(number, line[match.end() :])]
            elif line.strip():
                yield from self._statement(number, "code", "", line)
        if step:
            yield from self._statement(current[0][0], "step", step, " ".join(each for _, each in current))

    def _statement(self, line: int, kind: Kind, step: str, text: str) -> Iterator[Statement]:
        plain = normalised(text)
        if not re.search(r"\w", plain):
            return
        yield Statement(
            self._file,
            tuple(title for _, title in self._headings),
            self._anchor,
            line,
            kind,
            step,
            fingerprint(plain),
            sketch(plain),
            kind in ("step", "code") or bool(_NORMATIVE.search(plain)),
            " ".join(text.split()),
        )
