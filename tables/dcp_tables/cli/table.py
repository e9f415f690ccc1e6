"""``dcp-codec table``: convert recordings to tables for DuckDB, Polars, pandas, spreadsheets."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from dcp_codec.cli.common import load_codec, note, profile_options
from dcp_codec.common.commandline import FORCE_HELP, ExpectedError, choice_option, expected, out_option

from .recordings import check_input, extras, need_duckdb, octets_progress, tell

if TYPE_CHECKING:
    from dcp_tables.table.archive import Order
    from dcp_tables.table.job import Outcome

#: Octets of recordings that one process decodes in the time that others need to start.
_LITTLE = 1 << 26

#: Suffix of --out -> format.
_FORMATS = {".parquet": "parquet", ".csv": "csv", ".duckdb": "duckdb", ".db": "duckdb"}


def _tables(_ctx: click.Context, _param: click.Parameter, value: tuple[str, ...]) -> tuple[str, ...] | None:
    """Parse names of tables, given separately or with commas."""
    return tuple(dict.fromkeys(name.strip() for part in value for name in part.split(","))) or None


def _known_tables(names: tuple[str, ...] | None, profile: str) -> None:
    """Refuse tables that no recording of that profile can have; a profile may define record types."""
    from dcp_tables.table.kernel.shape import HOLDINGS, TABLES, table_names

    known = (*(TABLES if profile == "auto" else table_names(load_codec(profile).profile)), HOLDINGS)
    for name in names or ():
        if name not in known:
            raise click.BadParameter(
                f"unknown table {name!r}; expected one of {', '.join(known)}", param_hint="'--tables'"
            )


@click.command(
    "table",
    epilog="FILE is an MCAP, pcap or pcapng recording, a folder with some, or a pattern in quotes; - is standard "
    "input. Tables and example queries: docs/tables.md. Exit status: 0 all good, 1 malformed DCP frames were seen "
    "(table 'errors' lists them), 2 wrong usage or input that could not be read to its end (the "
    "readable part is written).",
)
@click.argument("files", nargs=-1, required=True, metavar="FILE...")
@out_option(
    "DIR|FILE", "Write to a folder, to a .duckdb database, or one table to a .parquet or .csv file.", required=True
)
@profile_options
@click.option(
    "-f",
    "--format",
    "form",
    type=click.Choice(["parquet", "csv", "duckdb"]),
    help="Format of the tables.  [default: by the suffix of --out, or parquet]",
)
@click.option(
    "--tables",
    multiple=True,
    callback=_tables,
    metavar="NAME,...",
    help="Write only these tables; 'holdings' is written only if it is named.",
)
@click.option(
    "-j",
    "--jobs",
    type=click.IntRange(min=1),
    metavar="N",
    help="Number of concurrent processes.  [default: one for each processor; 1 for less than 64 MiB]",
)
@choice_option(
    "--engine",
    of=["local", "dask"],
    help="Decode in processes of this machine, or by the workers of a Dask cluster.",
)
@click.option(
    "--scheduler", metavar="ADDRESS", help="Dask scheduler, such as tcp://host:8786.  [default: start a local one]"
)
@click.option("--force", is_flag=True, help=FORCE_HELP)
def command(
    files: tuple[str, ...],
    out: Path,
    profile: str,
    ether_type: int | None,
    form: str | None,
    tables: tuple[str, ...] | None,
    jobs: int | None,
    engine: str,
    scheduler: str | None,
    force: bool,
) -> int:
    """Turn recordings into tables: beacons, payloads, state reports, containers, records, errors.

    Rows are joined by the columns frame and time, and file if there are several recordings.
    """
    if scheduler is not None and engine != "dask":
        raise click.UsageError("--scheduler is for --engine dask")
    check_input(files, profile)
    _known_tables(tables, profile)
    form = form or _FORMATS.get(out.suffix.lower(), "parquet")
    if form == "duckdb":
        need_duckdb()
    with extras():
        from dcp_tables.table.archive import Order, find_recordings
        from dcp_tables.table.job import TableError

        with expected(TableError):
            recordings = tuple(find_recordings(files))
            order = Order(
                recordings=recordings,
                out=out,
                form=form,  # type: ignore[arg-type]
                profile=profile,
                ether_type=ether_type,
                tables=tables,
                jobs=jobs or workers(recordings, engine),
                engine=engine,  # type: ignore[arg-type]
                scheduler=scheduler,
                force=force,
            )
            outcomes = _make(order)
    return max(tell(outcome) for outcome in outcomes)


def workers(recordings: Sequence[str], engine: str) -> int:
    """Return the number of worker processes: starting one takes as long as decoding some megabytes."""
    sizes = [path.stat().st_size for path in map(Path, recordings) if path.is_file()]
    if engine == "local" and len(sizes) == len(recordings) and sum(sizes) < _LITTLE:
        return 1
    return len(os.sched_getaffinity(0))


def _make(order: Order) -> list[Outcome]:
    from dcp_tables.table.archive import make

    with octets_progress(order.recordings) as advance:
        outcomes = make(order, advance)
    if all(outcome.failure is not None for outcome in outcomes):
        raise ExpectedError("; ".join(str(outcome.failure) for outcome in outcomes[:5]))
    total: dict[str, int] = {}
    for outcome in outcomes:
        for name, rows in outcome.rows.items():
            total[name] = total.get(name, 0) + rows
    listed = ", ".join(f"{name} {rows}" for name, rows in total.items())
    note(f"{order.out}: {listed} rows")
    return outcomes
