"""Check many citations: change the cited code, and run the cases and tests that name the requirement."""

from __future__ import annotations

import ast
import contextlib
import time
from collections.abc import Callable, Iterable, Sequence
from fnmatch import fnmatchcase
from functools import partial
from multiprocessing.context import ForkServerContext
from pathlib import Path
from typing import Final, Literal

import msgspec
from dcp_conformance.errors import UsageError
from dcp_spec.version import __version__

from dcp_codec.common.workers import completed
from dcp_selftest.generated.isolation import ask, process_context
from dcp_selftest.generated.trial import limit

from .changes import CodeChange, changes_under
from .ledger import key, ledger
from .places import Citation, citations
from .trial import Noticed, try_change
from .unit_tests import failing_test

SCHEMA: Final = "dcp-conformance-citations/1"
#: Maximum numbers of changes for each place: tried with the cases, and tried with the unit tests.
_TRIED: Final = 16
_TESTED: Final = 4

Proof = Literal["case", "test", "breaks", "none", "no change"]


class Verdict(msgspec.Struct, frozen=True):
    """A citation, and the evidence that the cited code fulfils the requirement."""

    citation: Citation
    proof: Proof
    """``case``, ``test``: a case or unit test that names the requirement detects a change; ``breaks``: changes only
    break the node as a whole; ``none``: no change is detected; ``no change``: the code has no possible change."""
    change: str = ""
    """The detected change."""
    by: str = ""
    """The case or the unit test that detects the change."""
    reason: str = ""
    """The reason in the ledger why no change can be detected; empty without an entry."""

    @property
    def proved(self) -> bool:
        """Whether a case or a test with the requirement depends on the cited code."""
        return self.proof in ("case", "test")

    @property
    def good(self) -> bool:
        """Whether the citation is proved, or the ledger has a reason why it cannot be."""
        return self.proved or bool(self.reason)


class CitationsResult(msgspec.Struct, frozen=True, kw_only=True):
    """The content of ``citations.json``."""

    schema: str = SCHEMA
    tool: str = f"dcp-conformance {__version__}"
    duration: float = 0.0
    """Seconds."""
    verdicts: tuple[Verdict, ...] = ()

    @property
    def unproved(self) -> tuple[Verdict, ...]:
        """Citations that are not proved and have no entry in the ledger."""
        return tuple(each for each in self.verdicts if not each.good)

    @property
    def outdated(self) -> tuple[Verdict, ...]:
        """Citations that are proved although the ledger has an entry for them."""
        return tuple(each for each in self.verdicts if each.proved and each.reason)


def chosen(patterns: Sequence[str]) -> list[Citation]:
    """Return the citations whose requirement or file matches a pattern; all citations without a pattern.

    Raise :class:`UsageError` for a pattern that matches no citation.
    """
    found: dict[Citation, None] = {}
    for pattern in patterns:
        # A file matches by its path or the end of its path: ``dcp_stack/bp/queue.py``, ``bp/queue.py``, ``queue.py``.
        meant = [
            each
            for each in citations()
            if fnmatchcase(each.requirement, pattern) or fnmatchcase(f"/{each.path}", f"*/{pattern}")
        ]
        if not meant:
            raise UsageError(f"{pattern!r} is neither a cited requirement nor a file that cites a requirement")
        found.update(dict.fromkeys(meant))
    return [each for each in citations() if not patterns or each in found]


def run(
    picked: Iterable[Citation],
    *,
    jobs: int | None = None,
    root: Path | None = None,
    on_result: Callable[[Verdict], None] | None = None,
) -> CitationsResult:
    """Check citations in ``jobs`` processes (default: one for each processor); return the verdicts in their order.

    ``root`` is the checkout with the unit tests; without it only cases are executed. ``on_result`` is called with each
    verdict when it is known.
    """
    began = time.monotonic()
    places: dict[tuple[str, int, int], list[Citation]] = {}
    order = {each: number for number, each in enumerate(picked)}
    for each in order:
        places.setdefault((each.path, each.first, each.last), []).append(each)
    context = process_context()
    verdicts: list[Verdict] = []

    with contextlib.suppress(KeyboardInterrupt):
        check = partial(_check, context, root)
        for _, group in completed(check, places.values(), jobs, start="thread"):
            for verdict in group:
                verdicts.append(verdict)
                if on_result is not None:
                    on_result(verdict)
    verdicts.sort(key=lambda each: order[each.citation])
    return CitationsResult(duration=round(time.monotonic() - began, 1), verdicts=tuple(verdicts))


def _check(context: ForkServerContext, root: Path | None, group: list[Citation]) -> list[Verdict]:
    """Return the verdicts of citations of the same code."""
    changes = changes_under(group[0])[:_TRIED]
    found: dict[str, Verdict] = {}
    unusable: dict[str, Verdict] = {}
    for change in changes:
        names = [each.requirement for each in group if each.requirement not in found]
        if not names:
            break
        noticed = _noticed(context, change, names)
        for each in group:
            name = each.requirement
            if name not in noticed.by:
                if noticed.unusable:
                    unusable.setdefault(name, Verdict(each, "breaks", change.text))
            elif not noticed.unusable:
                found.setdefault(name, Verdict(each, "case", change.text, noticed.by[name]))
            elif not unusable.get(name, Verdict(each, "none")).proved:
                # Weak evidence, because the whole node is impaired: keep looking for a change that impairs it less.
                unusable[name] = Verdict(each, "case", change.text, noticed.by[name])
    found = {**{name: each for name, each in unusable.items() if each.proved}, **found}
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
        other = unusable.get(each.requirement) or Verdict(each, "none" if changes else "no change")
        verdict = other if proved is None else proved
        verdicts.append(msgspec.structs.replace(verdict, citation=each, reason=ledger().get(key(each), "")))
    return verdicts


def _one_of_each(citation: Citation) -> list[CodeChange]:
    """Return the first change of each kind, up to ``_TESTED``: unit tests take longer than cases."""
    return list({each.operator: each for each in reversed(changes_under(citation))}.values())[::-1][:_TESTED]


def _noticed(context: ForkServerContext, change: CodeChange, names: list[str]) -> Noticed:
    answer, _ = ask(context, _try, change, names)
    return msgspec.json.decode(answer, type=Noticed) if answer else Noticed({}, unusable=True)


def _try(change: CodeChange, names: list[str]) -> bytes:
    limit()
    return msgspec.json.encode(try_change(change, names))
