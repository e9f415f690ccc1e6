"""Tables of a judged recording as CSV files: the ledger, the links, and the findings."""

from __future__ import annotations

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from dcp_codec.analysis.holdings import Holding, holdings
from dcp_codec.common.atomic_write import write_whole
from dcp_conformance.definitions.results import RunResult
from dcp_conformance.errors import UsageError

from .judge import Judge

HOLDINGS = (*Holding._fields[:-1], "lagSeconds")
LINKS = ("listener", "speaker", "share", "reactions", "trials", "until", "told")
EVENTS = ("time", "frame", "rule", "verdict", "observed")


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
    for each in holdings(ledger, judge.codec.profile.types.node_id.representation):
        row: dict[str, object] = each._asdict()
        row["since"], row["until"] = (f"{(time - begin) / 1e9:.6f}" for time in (each.since, each.until))
        row["lag"] = None if each.lag is None else f"{each.lag / 1e9:.6f}"
        yield ["" if value is None else value for value in row.values()]


def _events(run: RunResult) -> Iterable[Sequence[object]]:
    for case in run.cases:
        for check in case.checks:
            if check.observed and check.verdict in ("fail", "inconclusive", "info"):
                time = "" if check.seconds is None else check.seconds
                frame = max((mark.frame for mark in check.frames), default="")
                yield time, frame, case.id, str(check.verdict), check.observed
