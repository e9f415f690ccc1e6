"""docs/tables.md: the tables are those it lists, and its queries give the same results as counting frames."""

from __future__ import annotations

import re
from collections import defaultdict
from pathlib import Path
from typing import Any

import duckdb
import pyarrow as pa
import pytest
from dcp_tables import ColumnDecoder
from dcp_tables.report.analysis import time_of
from dcp_tables.report.holding import holding
from dcp_tables.report.recorded import gather
from dcp_tables.table.holdings import HOLDINGS_SCHEMA
from dcp_tables.table.kernel.shape import HOLDINGS

from dcp_codec import get_codec
from dcp_codec.capture import create_capture
from dcp_codec.cli import main

pytestmark = pytest.mark.part("tables")

ROOT = Path(__file__).resolve().parents[2]
TEXT = (ROOT / "docs" / "tables.md").read_text(encoding="utf-8")
#: The queries by their headings.
_QUESTIONS = TEXT[TEXT.index("## Questions to ask") :]
QUERIES = dict(re.findall(r"### (.*)\n(?:(?!#|```).*\n)*```sql\n((?:.*\n)*?)```", _QUESTIONS))
LOSS, AGE, DELAY, STALE, OVERHEAD = (
    "Loss per link over time",
    "Age of information per neighbour pair",
    "Dissemination delay of each variable update, node by node",
    "Stale values",
    "Overhead per byte",
)


def test_all_queries_are_found():
    assert set(QUERIES) == {LOSS, AGE, DELAY, STALE, OVERHEAD}
    assert TEXT.count("```sql") == len(QUERIES)


def tables_of(path: Path, folder: Path) -> None:
    with pytest.raises(SystemExit) as stop:
        main(["table", str(path), "--out", str(folder / "tables"), "--profile", "auto"])
    assert stop.value.code == 0


def ask(query: str, folder: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    monkeypatch.chdir(folder)
    with duckdb.connect() as database:
        found = database.execute(QUERIES[query])
        names = [column[0] for column in found.description]
        return [dict(zip(names, row, strict=True)) for row in found.fetchall()]


@pytest.fixture(scope="module")
def frames(recording, reference, frames_of):
    path, codec = recording
    return reference(codec, frames_of(path))


@pytest.fixture(scope="module")
def folder(recording, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the tables of a recording."""
    path: Path = tmp_path_factory.mktemp("recording")
    tables_of(recording[0], path)
    return path


def test_loss(recording, frames_of, tmp_path, monkeypatch, reference):
    """Of a recording from which beacons were taken, as many are missing as were taken."""
    path, codec = recording
    frames = frames_of(path)
    senders = {row["frame"]: row["sender"] for row in reference(codec, frames)["beacons"]}
    firsts = {sender: min(n for n, other in senders.items() if other == sender) for sender in senders.values()}
    lasts = {sender: max(n for n, other in senders.items() if other == sender) for sender in senders.values()}
    ends = set(firsts.values()) | set(lasts.values())
    lost: dict[str, int] = defaultdict(int)
    with create_capture(tmp_path / "lossy.pcapng") as writer:
        for frame in frames:
            if frame.number % 7 == 0 and frame.number not in ends:
                lost[senders[frame.number]] += 1
            else:
                writer.write(frame)
    tables_of(tmp_path / "lossy.pcapng", tmp_path)
    rows = ask(LOSS, tmp_path, monkeypatch)
    assert {row["interface"] for row in rows} == {0}
    for sender, number in lost.items():
        mine = [row for row in rows if row["sender"] == sender]
        assert sum(row["lost"] for row in mine) == number
        assert sum(row["received"] for row in mine) == list(senders.values()).count(sender) - number
        assert all(row["loss"] == row["lost"] / (row["lost"] + row["received"]) for row in mine)


def test_age(frames, folder, monkeypatch):
    rows = ask(AGE, folder, monkeypatch)
    ages: dict[tuple[str, str], list[int]] = defaultdict(list)
    last: dict[str, int] = {}
    reports = defaultdict(list)
    for report in frames["srp"]:
        reports[report["frame"]].append(report)
    for beacon in frames["beacons"]:
        for report in reports[beacon["frame"]]:
            last[report["nodeId"]] = report["tStamp"]
        for node, stamp in last.items():
            if node != beacon["sender"]:
                ages[beacon["sender"], node].append(beacon["time"] - stamp)
    assert {(row["node"], row["neighbour"]): row["samples"] for row in rows} == {k: len(v) for k, v in ages.items()}
    for row in rows:
        found = ages[row["node"], row["neighbour"]]
        assert row["mean_age_ms"] == pytest.approx(sum(found) / len(found) / 1e6)
        assert row["max_age_ms"] == pytest.approx(max(found) / 1e6)


def test_delay(frames, folder, monkeypatch):
    rows = ask(DELAY, folder, monkeypatch)
    versions: dict[tuple[int, int], list[dict[str, Any]]] = defaultdict(list)
    last: dict[tuple[int, int], int] = {}
    for record in sorted(frames["creates"] + frames["updates"], key=lambda record: record["time"]):
        key = (record["varId"], record["seqno"])
        if key not in last or record["time"] - last[key] > 5 * 10**9:
            versions[key].append({})
        last[key] = record["time"]
        versions[key][-1].setdefault(record["sender"], record["time"])
    assert len(rows) == sum(len(first) for rounds in versions.values() for first in rounds)
    for row in rows:
        first = versions[row["varId"], row["seqno"]][row["round"]]
        order = sorted(first.values())
        assert order[row["place"]] == first[row["sender"]]
        assert row["delay_ms"] == pytest.approx((first[row["sender"]] - order[0]) / 1e6)
        before = order[row["place"] - 1] if row["place"] else None
        assert row["step_ms"] == (None if before is None else pytest.approx((order[row["place"]] - before) / 1e6))


def test_overhead(frames, folder, monkeypatch):
    rows = ask(OVERHEAD, folder, monkeypatch)
    # Every octet of the frames is in one part.
    assert sum(row["octets"] for row in rows) == sum(row["frameLength"] for row in frames["beacons"])
    assert sum(row["share"] for row in rows) == pytest.approx(1)
    names = {row["part"]: row["octets"] for row in rows}
    assert names["payload header"] == 4 * len(frames["payloads"])
    assert names["SUMMARIES"] == sum(row["octets"] for row in frames["containers"] if row["icName"] == "SUMMARIES")
    values = sum(len(row["value"]) // 2 for row in frames["updates"] + frames["creates"])
    assert all(row["per_octet_of_value"] == pytest.approx(row["octets"] / values) for row in rows)


# -- the schema ---------------------------------------------------------------------------------------------------


def shown(kind: pa.DataType) -> str:
    """How the document writes a type."""
    if pa.types.is_dictionary(kind):
        return "text (dictionary)"
    names = {"string": "text", "binary": "octets", "timestamp[ns]": "timestamp, ns"}
    names |= {"float": "float32", "double": "float64"}
    return names.get(str(kind), str(kind).replace("fixed_size_binary", "octets"))


def test_stale_values(tmp_path, monkeypatch):
    """The table of holdings has the stale values of the page."""
    path = ROOT / "captures" / "b_crud.mcap"
    with pytest.raises(SystemExit) as stop:
        main(["table", str(path), "--out", str(tmp_path / "tables"), "--tables", "holdings"])
    assert stop.value.code == 0
    recorded = gather(str(path), "cpp-2.0", None)
    stale = holding(recorded, time_of(recorded)).stale
    assert len(stale) > 4
    rows = ask(STALE, tmp_path, monkeypatch)
    assert [row["lag_s"] for row in rows] == pytest.approx(sorted((each.age for each in stale), reverse=True))
    assert sorted((row["node"], row["varId"], row["seqno"], row["lagValues"]) for row in rows) == sorted(
        (recorded.nodes[each.node], each.variable, each.held, each.missed) for each in stale
    )


def test_holdings_need_a_file(capsys):
    with pytest.raises(SystemExit) as stop:
        main(["table", "-", "-p", "cpp-2.0", "--out", "nowhere.csv", "--tables", "holdings"])
    assert stop.value.code == 2
    assert "standard input cannot be read twice" in capsys.readouterr().err


def test_every_column_is_described():
    documented = dict(re.findall(r"^\| `(\w+)` \| ([^|]*) \|", TEXT[: TEXT.index("### beacons")], re.MULTILINE))
    schemas = ColumnDecoder(get_codec("cpp-2.0"), interpret=True).schemas | {HOLDINGS: HOLDINGS_SCHEMA}
    sections = re.split(r"^### ", TEXT[: TEXT.index("## Questions to ask")], flags=re.MULTILINE)[1:]
    assert [section.split("\n")[0] for section in sections] == [
        "beacons", "payloads", "srp", "containers", "creates", "updates", "deletes", "summaries", "req_updates",
        "req_creates", "errors", "holdings",
    ]  # fmt: skip
    for section in sections:
        name = section.split("\n")[0]
        keys = re.findall(r"`(\w+)`", next((line for line in section.split("\n") if line.startswith("Keys:")), ""))
        listed = {key: documented[key] for key in keys}
        units = {}
        for column, kind, unit, meaning in re.findall(r"^\| `(\w+)` \| (.*?) \| (.*?) \| (.*?) \|$", section, re.M):
            listed[column], units[column] = kind, (unit, meaning)
        assert listed == {field.name: shown(field.type) for field in schemas[name]}
        for field in schemas[name]:
            if field.name in units:
                metadata = field.metadata or {}
                assert units[field.name] == (metadata.get(b"unit", b"").decode(), metadata.get(b"doc", b"").decode())
