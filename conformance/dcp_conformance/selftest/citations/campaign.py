"""Many citations: each is held to what it stands on."""

from __future__ import annotations

import ast
import time
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Final, Literal

import msgspec
from dcp_spec.version import __version__

from dcp_conformance.errors import UsageError
from dcp_conformance.selftest.generated.isolation import ask, concurrently, process_context
from dcp_conformance.selftest.generated.trial import limit

from .changes import CodeChange, changes_under
from .ledger import key, ledger
from .places import Citation, citations
from .trial import Noticed, try_change
from .unit_tests import failing_test

SCHEMA: Final = "dcp-conformance-citations/1"
#: Changes of one place that are tried with the cases, and with the tests.
_TRIED: Final = 16
_TESTED: Final = 4

Proof = Literal["case", "test", "breaks", "none", "no change"]


class Verdict(msgspec.Struct, frozen=True):
    """A citation, and what shows that it stands in the right place."""

    citation: Citation
    proof: Proof
    """``case``, ``test``: one that names the requirement notices a change; ``breaks``: changes only break the node as a
    whole; ``none``: no change is noticed; ``no change``: there is nothing that could be changed."""
    change: str = ""
    by: str = ""
    """The case or the test."""
    reason: str = ""
    """What the ledger says."""

    @property
    def proved(self) -> bool:
        """Whether a case or a test with the requirement depends on the cited code."""
        return self.proof in ("case", "test")

    @property
    def good(self) -> bool:
        """Whether it is proved, or the ledger says why not."""
        return self.proved or bool(self.reason)


class CitationsResult(msgspec.Struct, frozen=True, kw_only=True):
    """What ``citations.json`` holds."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    duration: float = 0.0
    """Seconds."""
    verdicts: tuple[Verdict, ...] = ()

    @property
    def unproved(self) -> tuple[Verdict, ...]:
        """Citations that nothing proves and nothing excuses."""
        return tuple(each for each in self.verdicts if not each.good)

    @property
    def outdated(self) -> tuple[Verdict, ...]:
        """Citations that are proved although the ledger says that they cannot be."""
        return tuple(each for each in self.verdicts if each.proved and each.reason)


def chosen(patterns: Sequence[str]) -> list[Citation]:
    """The citations of requirements, or in files, that identifiers or globs mean; all without any.

    Raises :class:`UsageError` for a pattern that means none.
    """
    found: dict[Citation, None] = {}
    for pattern in patterns:
        # A file is named by its path, or by the end of it: ``dcp_stack/bp/queue.py``, ``bp/queue.py``, ``queue.py``.
        meant = [
            each
            for each in citations()
            if fnmatchcase(each.requirement, pattern) or fnmatchcase(f"/{each.path}", f"*/{pattern}")
        ]
        if not meant:
            raise UsageError(f"{pattern!r} is neither a requirement that is cited nor a file that cites one")
        found.update(dict.fromkeys(meant))
    return [each for each in citations() if not patterns or each in found]


def run(
    picked: Iterable[Citation],
    *,
    jobs: int | None = None,
    root: Path | None = None,
    on_result: Callable[[Verdict], None] | None = None,
) -> CitationsResult:
    """Check citations. ``root``: the checkout with the unit tests; without it only cases are asked."""
    began = time.monotonic()
    places: dict[tuple[str, int, int], list[Citation]] = {}
    order = {each: number for number, each in enumerate(picked)}
    for each in order:
        places.setdefault((each.path, each.first, each.last), []).append(each)
    context = process_context()
    verdicts: list[Verdict] = []

    def done(group: list[Verdict]) -> None:
        for verdict in group:
            verdicts.append(verdict)
            if on_result is not None:
                on_result(verdict)

    concurrently(lambda cited: _check(context, cited, root), places.values(), jobs, done)
    verdicts.sort(key=lambda each: order[each.citation])
    return CitationsResult(duration=round(time.monotonic() - began, 1), verdicts=tuple(verdicts))


def _check(context: ForkServerContext, group: list[Citation], root: Path | None) -> list[Verdict]:
    """Citations over the same code."""
    changes = changes_under(group[0])[:_TRIED]
    found: dict[str, Verdict] = {}
    crippled: dict[str, Verdict] = {}
    for change in changes:
        names = [each.requirement for each in group if each.requirement not in found]
        if not names:
            break
        noticed = _noticed(context, change, names)
        for each in group:
            name = each.requirement
            if name not in noticed.by:
                if noticed.crippled:
                    crippled.setdefault(name, Verdict(each, "breaks", change.text))
            elif not noticed.crippled:
                found.setdefault(name, Verdict(each, "case", change.text, noticed.by[name]))
            elif not crippled.get(name, Verdict(each, "none")).proved:
                # Better than nothing: another change may show it without crippling the node.
                crippled[name] = Verdict(each, "case", change.text, noticed.by[name])
    found = {**{name: each for name, each in crippled.items() if each.proved}, **found}
    for each in group:
        for change in _one_of_each(group[0]) if root is not None and each.requirement not in found else ():
            assert root is not None
            failed = failing_test(root, each.requirement, change.module, ast.unparse(change.tree()))
            if failed:
                found[each.requirement] = Verdict(each, "test", change.text, failed)
                break
    verdicts = []
    for each in group:
        proved = found.get(each.requirement)
        other = crippled.get(each.requirement) or Verdict(each, "none" if changes else "no change")
        verdict = other if proved is None else proved
        verdicts.append(msgspec.structs.replace(verdict, citation=each, reason=ledger().get(key(each), "")))
    return verdicts


def _one_of_each(citation: Citation) -> list[CodeChange]:
    """The first change of each kind: tests take longer than cases."""
    return list({each.operator: each for each in reversed(changes_under(citation))}.values())[::-1][:_TESTED]


def _noticed(context: ForkServerContext, change: CodeChange, names: list[str]) -> Noticed:
    answer, _ = ask(context, _try, change, names)
    return msgspec.json.decode(answer, type=Noticed) if answer else Noticed({}, crippled=True)


def _try(change: CodeChange, names: list[str]) -> bytes:
    limit()
    return msgspec.json.encode(try_change(change, names))
