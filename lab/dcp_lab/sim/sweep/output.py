"""The files of a study: tables, plot, page and bundle."""

from __future__ import annotations

import base64
import csv
import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Final

from dcp_spec.version import __version__

from .plan import Study, short
from .results import Estimate, Outcome, Summary, farthest, rows

#: Columns of the tables for people: title, estimate, and number of digits.
_COLUMNS: Final = (("share", "share", 3), ("delay_ms", "delay ms", 1), ("newest", "newest", 3))


def table(study: Study, found: Sequence[Summary]) -> tuple[list[str], list[list[str]]]:
    """Return header and rows of the table for people: for each cell the farthest nodes."""
    header = [*map(short, study.axes), "hops"]
    for name, title, _ in _COLUMNS:
        header += [title, "change"] if name == "share" and study.compare else [title]
    body = []
    for each in farthest(found):
        row = [*(str(study.cells[each.cell][key]) for key in study.axes), str(each.hops)]
        for name, _, digits in _COLUMNS:
            mark = " *" if name == "delay_ms" and each.few else ""
            row.append(_text(getattr(each, name), digits) + mark)
            if name == "share" and study.compare:
                row.append(_text(each.differences.get(name), digits, signed=True))
        body.append([*row, str(each.seeds)])
    return [*header, "n"], body


def notes(study: Study, found: Sequence[Summary]) -> list[str]:
    """Return sentences about the marks and columns of the table."""
    far = farthest(found)
    said = []
    if few := sum(each.few for each in far):
        said.append(f"* {few} of {len(far)} cells have fewer than 10 receptions")
    if study.compare and any("share" in each.differences for each in far):
        said.append(
            f"change: difference of the share from the preceding {short(study.compare)}, in pairs of runs with the "
            "same seed (common random numbers)"
        )
    return said


def _text(estimate: Estimate | None, digits: int, *, signed: bool = False) -> str:
    return "-" if estimate is None else estimate.text(digits, signed=signed)


def write_tables(study: Study, outcomes: Sequence[Outcome], found: Sequence[Summary], folder: Path) -> list[str]:
    """Write table.csv, runs.csv and bundle.json; returns their names."""
    lines: list[dict[str, Any]] = []
    for each in found:
        line: dict[str, Any] = {**study.cells[each.cell], "kind": each.kind, "hops": each.hops, "seeds": each.seeds}
        line |= {"received": each.received, "few": each.few}
        for name, _, _ in _COLUMNS:
            for key, estimate in ((name, getattr(each, name)), (f"{name}_difference", each.differences.get(name))):
                line[key] = None if estimate is None else estimate.mean
                line[f"{key}_ci95"] = None if estimate is None else estimate.half
        lines.append(line)
    _csv(folder / "table.csv", lines)
    _csv(folder / "runs.csv", list(rows(study, outcomes)))
    bundle = {
        "study": study.raw,
        "kit_version": __version__,
        "python_version": sys.version.split()[0],
        "seeds": study.seeds,
        "digests": {each.key: each.digest for each in outcomes},
    }
    (folder / "bundle.json").write_text(json.dumps(bundle, indent=1) + "\n", encoding="utf-8")
    return ["table.csv", "runs.csv", "bundle.json"]


def _csv(path: Path, lines: Sequence[dict[str, Any]]) -> None:
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, list(lines[0]) if lines else [])
        writer.writeheader()
        writer.writerows(lines)


def write_parquet(study: Study, outcomes: Sequence[Outcome], _found: Sequence[Summary], folder: Path) -> list[str]:
    """Write the rows of all runs as Parquet; returns the name of the file. Raises ``ImportError`` without pyarrow."""
    import pyarrow
    import pyarrow.parquet

    found = list(rows(study, outcomes))
    columns = {
        # Values of different types in one list, such as numbers and texts, are texts.
        key: [str(each[key]) if isinstance(each[key], dict | list) else each[key] for each in found]
        for key in (found[0] if found else ())
    }
    pyarrow.parquet.write_table(pyarrow.table(columns), folder / "runs.parquet")
    return ["runs.parquet"]


def write_page(study: Study, outcomes: Sequence[Outcome], found: Sequence[Summary], folder: Path) -> list[str]:
    """Write plot and page; returns the names of the files. Raises ``ImportError`` without matplotlib or Jinja."""
    from dcp_codec.common import pages

    from .plot import draw

    names, plot = ["page.html"], None
    if study.axes and found:
        draw(study, farthest(found), folder / "plot.svg", folder / "plot.png")
        plot = "data:image/svg+xml;base64," + base64.b64encode((folder / "plot.svg").read_bytes()).decode()
        names = ["plot.svg", "plot.png", *names]
    header, body = table(study, found)
    facts = [(key, ", ".join(dict.fromkeys(str(cell[key]) for cell in study.cells))) for key in study.axes]
    page = pages.render(
        __package__,
        "study.html",
        title=study.raw.get("title") or "Study",
        tiles_of=[(len(study.cells), "combinations", ""), (study.seeds, "seeds", ""), (len(outcomes), "runs", "")],
        facts=[*facts, ("kit", f"{__version__}, Python {sys.version.split()[0]}"), ("repeat", "--verify bundle.json")],
        plot=plot,
        header=header,
        rows=body,
        note=" ".join(f"{each}." for each in notes(study, found)),
    )
    (folder / "page.html").write_text(page, encoding="utf-8")
    return names
