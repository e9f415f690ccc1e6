"""Tables of a judged recording as CSV files: the ledger, the links, and the findings."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.common.atomic_write import write_whole
from dcp_conformance.errors import UsageError
from dcp_conformance.model.results import RunResult

from .base import name
from .judge import Judge

HOLDINGS = (
    "node", "varId", "state", "seqno", "producer", "creationTime", "since", "until", "firstFrame", "lastFrame",
    "values", "firstValueFrame", "requests", "lagValues", "lagSeconds",
)  # fmt: skip
LINKS = ("listener", "speaker", "share", "reactions", "trials", "until", "told")
EVENTS = ("time", "frame", "rule", "verdict", "observed")
_STATES = {DELETED: "deleted", UNKNOWN: "unknown"}


def write_tables(judge: Judge, run: RunResult, folder: Path) -> None:
    """Write ``holdings.csv``, ``links.csv`` and ``events.csv``. Times are seconds since the first frame.

    ``lagValues``: number of values of the producer that the node had not followed when it left the state,
    ``lagSeconds``: the time since the producer had left it; both are empty for a state that is not stale. Raises
    :class:`UsageError` if a file cannot be written.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _write(folder / "holdings.csv", HOLDINGS, _holdings(judge))
        _write(folder / "links.csv", LINKS, ([getattr(each, column) for column in LINKS] for each in run.links))
        _write(folder / "events.csv", EVENTS, _events(run))
    except OSError as error:
        raise UsageError(f"{error.filename or folder}: cannot be written: {error.strerror}") from None


def _write(path: Path, head: Sequence[str], rows: Iterable[Sequence[object]]) -> None:
    import io

    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(rows)
    write_whole(path, text.getvalue().encode("utf-8", "backslashreplace"))


def _holdings(judge: Judge) -> Iterable[Sequence[object]]:
    ledger = judge.ledger
    begin = ledger.begin or 0
    for each in ledger.entries():
        creation = each.creation
        yield (
            name(each.node), each.var_id, _STATES.get(each.number, "held"), each.number if each.number >= 0 else "",
            name(creation[0]) if creation else "", creation[1] if creation and creation[1] is not None else "",
            f"{(each.time - begin) / 1e9:.6f}", f"{(each.until - begin) / 1e9:.6f}", each.frame, each.last,
            each.values, each.carried[0][0] if each.carried else "", each.asked,
            each.missed if each.age else "", f"{each.age / 1e9:.6f}" if each.age else "",
        )  # fmt: skip


def _events(run: RunResult) -> Iterable[Sequence[object]]:
    for case in run.cases:
        for check in case.checks:
            if check.observed and check.verdict in ("fail", "inconclusive", "info"):
                time = "" if check.seconds is None else check.seconds
                frame = max((mark.frame for mark in check.frames), default="")
                yield time, frame, case.id, str(check.verdict), check.observed
