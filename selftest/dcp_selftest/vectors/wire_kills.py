"""Changes of the generated decoder and encoder that the wire vectors detect."""

from __future__ import annotations

import ast
import copy
import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Final, NamedTuple
from unittest.mock import patch

import msgspec
from dcp_conformance.vectors import wire

from dcp_codec.codec import Codec
from dcp_codec.errors import DecodeError
from dcp_codec.plan.source import Source
from dcp_codec.values import Beacon
from dcp_selftest.generated.sites import changes, replace

#: Seconds after which a changed codec that does not end is killed.
_PATIENCE: Final = 5


#: Functions of the generated source that make an error; their last argument is what was complete before.
_FAULTS: Final = ("short_run", "fail_")


class Change(NamedTuple):
    """One change of a generated function."""

    what: str
    """``decoder`` or ``encoder``, line, and the change."""
    function: Callable[..., Any]


class Outcome(msgspec.Struct, frozen=True):
    """The result for one change."""

    change: str
    vector: str
    """The first vector that detects it; empty if none does."""


def generated(codec: Codec) -> dict[str, tuple[str, dict[str, Any]]]:
    """Return source and names of decoder and encoder of a profile."""
    found: dict[str, tuple[str, dict[str, Any]]] = {}
    original = Source.compile

    def kept(self: Source, title: str) -> Any:
        made = original(self, title)
        found[title.split()[0]] = "\n".join(self.lines) + "\n", self.namespace
        return made

    fresh = Codec(codec.profile)
    with patch.object(Source, "compile", kept):
        fresh.decode_from(fresh.encode(_beacon(codec)))
    return found


def _beacon(codec: Codec) -> Beacon:
    from dcp_codec.export.example import example_beacon

    return example_beacon(codec)


def changed(text: str, names: dict[str, Any], title: str) -> Iterator[Change]:
    """Yield all single changes of a generated function that octets or values can show."""
    tree = ast.parse(text)
    nodes, unseen = list(ast.walk(tree)), set(map(id, _unseen(tree)))
    for number, node in enumerate(nodes):
        if id(node) in unseen:
            continue
        for place, change in enumerate(changes(node)):
            other = copy.deepcopy(tree)
            old = list(ast.walk(other))[number]
            new = list(changes(old))[place].replacement
            new = ast.Pass() if new is None else new
            if ast.unparse(old) == ast.unparse(new):
                continue
            replace(other, old, ast.copy_location(new, old))
            what = f"{title} {getattr(node, 'lineno', 0)}: {change.operator}: {ast.unparse(old)[:60]} -> "
            namespace = dict(names)
            try:
                exec(compile(ast.fix_missing_locations(other), title, "exec"), namespace)  # noqa: S102 - our own source
            except (SyntaxError, ValueError):
                continue
            functions = [each for each in tree.body if isinstance(each, ast.FunctionDef)]
            yield Change(what + ast.unparse(new)[:60], namespace[functions[-1].name])


def _unseen(tree: ast.AST) -> Iterator[ast.AST]:
    """Yield what no octets show: checks of the types of Python values, and the part before a problem in its error."""
    for node in ast.walk(tree):
        raised = node.body[0] if isinstance(node, ast.If) else None
        if isinstance(raised, ast.Raise) and isinstance(raised.exc, ast.Name):
            yield from ast.walk(node)
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id.startswith(_FAULTS):
            yield from ast.walk(node.args[-1])


class Expected(NamedTuple):
    """A vector with the values of the unchanged codec."""

    tc_id: str
    octets: bytes
    beacon: Any
    """Beacon and end, or the problem."""
    encoded: bool


def expected(codec: Codec, vectors: Sequence[wire.Vector]) -> list[Expected]:
    """Return the vectors as values."""
    found = []
    for each in vectors:
        octets = bytes.fromhex(each.octets)
        if each.problem is None:
            found.append(Expected(each.tc_id, octets, codec.decode_from(octets), each.direction == "both"))
        else:
            found.append(Expected(each.tc_id, octets, each.problem, encoded=False))
    return found


def detected(title: str, function: Callable[..., Any], vectors: Sequence[Expected]) -> str:
    """Return the first vector that a changed function fails; empty if it passes all."""
    for each in vectors:
        try:
            with _limited():
                same = _same(title, function, each)
        except Exception:
            same = False
        if not same:
            return each.tc_id
    return ""


def _same(title: str, function: Callable[..., Any], vector: Expected) -> bool:
    if title == "encoder":
        return not vector.encoded or bool(function(vector.beacon[0]) == vector.octets)
    try:
        found = function(vector.octets, 0, len(vector.octets))
    except DecodeError as error:
        found = wire.expected_of(error.problem)
    # NaN differs from itself.
    return bool(found == vector.beacon) or repr(found) == repr(vector.beacon)


@contextmanager
def _limited() -> Iterator[None]:
    def stop(number: int, frame: object) -> None:
        del number, frame
        raise TimeoutError

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(_PATIENCE)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def outcomes(codec: Codec) -> Iterator[Outcome]:
    """Yield the outcome of each change of the codec of a profile."""
    vectors = expected(codec, wire.vectors(codec))
    sources = generated(codec)
    for title in ("decoder", "encoder"):
        for each in changed(*sources[title], title):
            yield Outcome(each.what, detected(title, each.function, vectors))


__all__ = ["Change", "Outcome", "changed", "detected", "expected", "generated", "outcomes"]
