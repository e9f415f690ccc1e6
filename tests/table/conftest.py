"""Expected tables of frames, computed from the dissector's JSON: the reference for all tests of this folder."""

from __future__ import annotations

import math
import re
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import pyarrow as pa
import pytest
from dcp_spec.constants import BP_PROTID_SRP
from dcp_spec.profile.definition import Link

from dcp_codec import Codec, Field, Payload, get_codec
from dcp_codec.capture import Frame, open_capture
from dcp_codec.framing.frames import FrameDissector
from dcp_codec.framing.locate import OtherTraffic, locate, mac
from dcp_codec.jsonform import beacon_json

from ..odd_profiles import NAMES, codec_of
from ..parts import also

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = {
    "a_bus3.mcap": "cpp-2.0",
    "a_bus3_v1.3.6.mcap": "cpp-1.3",
    "b_crud.mcap": "cpp-2.0",
    "c_latejoin.mcap": "cpp-2.0",
}
RECORD_TABLES = {
    "SUMMARIES": "summaries",
    "UPDATES": "updates",
    "REQUEST-VARUPDATES": "req_updates",
    "REQUEST-VARCREATES": "req_creates",
    "CREATE-VARIABLES": "creates",
    "DELETE-VARIABLES": "deletes",
}
#: Containers of the profiles in tests that have some of their own.
OWN_TABLES = {"GEO-FENCE": "geo_fence", "Ping": "ping", "x1": "x1"}
#: Node identifiers and opaque regions that do not fit a register.
_LONG = """
    extends = "dcp-2.0"
    name = "odd-octets"
    [types]
    node_id = { width = 12, representation = "hex" }
    [bp]
    payload_header = ["protocolId", { opaque = 9, name = "time" }, "length"]
    [srp]
    record = ["sData", { opaque = 20, name = "frame" }, "nodeId", "tStamp", "seqno"]
"""

Tables = dict[str, list[dict[str, Any]]]


def expected_tables(codec: Codec, frames: Iterable[Frame], link: Link | None = None) -> Tables:
    """The rows of every table, values as in JSON."""
    link = link or codec.profile.link
    dissector = FrameDissector(codec, link)
    tables: Tables = defaultdict(list)
    for frame in frames:
        framing = locate(frame.data, link)
        if isinstance(framing, OtherTraffic):
            continue
        found = dissector.dissect(frame)
        assert not isinstance(found, OtherTraffic)
        keys = {"frame": frame.number, "time": frame.time_ns, "sender": found.sender}
        octets = frame.data[framing.start : framing.end]
        salvaged = codec.salvage(octets)
        for problem in salvaged.faults:
            values = {name: getattr(problem, name) for name in ("reason", "path", "requirement")}
            values["offset"] = problem.offset + framing.start
            for name in ("needed", "available"):
                number = getattr(problem, name)
                values[name] = number if number is None else min(number, 2**63 - 1)
            block = re.match(r"payloads\[(\d+)\]", problem.path)
            tables["errors"].append(keys | values | {"payload": None if block is None else int(block[1])})
        if salvaged.beacon is None or not salvaged.clear:
            continue
        tree = codec.salvage_tree(octets, salvaged)
        data = beacon_json(codec, tree.root)
        header = {name: value for name, value in (data.get("bp") or {}).items() if name not in constant(codec)}
        ours = {
            "interface": frame.interface,
            "frameLength": frame.orig_len,
            "octets": salvaged.end,
            "padding": len(octets) - salvaged.end,
            "src": mac(framing.src or b""),
            "dst": mac(framing.dst or b""),
        }
        tables["beacons"].append(keys | ours | header)
        blocks = tree.root.child("payloads")
        assert blocks is not None
        for index, payload in enumerate(salvaged.beacon.payloads):
            said = sound_part(codec, data["payloads"][index], payload, salvaged.octets_of(index) is not None)
            payload_rows(tables, keys | {"payload": index}, said, blocks.children[index])
    return tables


def sound_part(codec: Codec, said: dict[str, Any], payload: Payload, damaged: bool) -> dict[str, Any]:
    """JSON of the sound parts of a payload block."""
    if not damaged:
        return said
    header = {name: value for name, value in said.items() if name not in ("srp", "vardis", "data")}
    name = "srp" if payload.protocol_id == BP_PROTID_SRP and codec.report_plan else "data"
    if payload.vardis is not None:
        return header | {"vardis": said.get("vardis", [])[: len(payload.vardis)]}
    return header | {name: None}


def constant(codec: Codec) -> set[str]:
    """Fields of the header that are not columns: those with one value, and the sender, which is a key."""
    names = {"version", "magicNo", "senderId"}
    return names | {"length"} if codec.profile.bp.length_means == "header-size" else names


def payload_rows(tables: Tables, keys: dict[str, Any], payload: dict[str, Any], part: Field) -> None:
    content = next(name for name in ("srp", "vardis", "data") if name in payload)
    own = {name: value for name, value in payload.items() if name not in ("srp", "vardis")}
    tables["payloads"].append(beside(keys, {"data": None, **own, "content": content}, "payload"))
    if payload.get("srp") is not None:
        report = payload["srp"]
        tables["srp" if "sData" in report else "own_report"].append(beside(keys, flat(report), "srp"))
    for place, container in enumerate(payload.get("vardis", ())):
        keys_of_it = keys | {"container": place}
        octets = (part.child("vardis") or part).children[place].length
        tables["containers"].append(
            {**keys_of_it, "octets": octets, **{k: v for k, v in container.items() if k != "records"}}
        )
        for number, record in enumerate(container["records"]):
            name = RECORD_TABLES.get(container["icName"]) or OWN_TABLES[container["icName"]]
            tables[name].append({**keys_of_it, "record": number, **flat(record)})


def beside(keys: dict[str, Any], values: dict[str, Any], record: str) -> dict[str, Any]:
    """Keys and values; a value whose name is that of a key gets the name of its record in front."""
    return keys | {f"{record}_{name}" if name in keys else name: value for name, value in values.items()}


def flat(record: dict[str, Any]) -> dict[str, Any]:
    """Nested records laid flat; a name that is taken gets that of its record in front."""
    found: dict[str, Any] = {}
    for name, value in record.items():
        if not isinstance(value, dict):
            found[name] = value
            continue
        for inner, below in value.items():
            found[f"{name}_{inner}" if inner in found else inner] = below
    return found


def rows_of(table: pa.Table | pa.RecordBatch) -> list[dict[str, Any]]:
    """The rows of an Arrow table with values as in JSON."""
    columns = {}
    for name in table.schema.names:
        column = table.column(name)
        if pa.types.is_timestamp(column.type):
            column = column.cast(pa.int64())
        columns[name] = [as_json(value) for value in column.to_pylist()]
    rows = [dict(zip(columns, values, strict=True)) for values in zip(*columns.values(), strict=True)]
    for row in rows:
        for name in [name for name in row if name.endswith("Hex")]:
            # As in JSON: the text, or its hex under another name.
            del row[name if row[name] is None else name.removesuffix("Hex")]
    return rows


def as_json(value: Any) -> Any:
    if isinstance(value, bytes):
        return value.hex()
    if isinstance(value, float) and not math.isfinite(value):
        return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"
    return value


def differences(found: Tables, expected: Tables) -> list[str]:
    """The first difference of each table, for a message that can be read."""
    listed = []
    for name in sorted(found.keys() | expected.keys()):
        ours, theirs = found.get(name, []), expected.get(name, [])
        if len(ours) != len(theirs):
            listed.append(f"{name}: {len(ours)} rows instead of {len(theirs)}")
        for number, (one, other) in enumerate(zip(ours, theirs, strict=False)):
            # The representation tells -0.0 from 0.0.
            if repr(sorted(one.items())) != repr(sorted(other.items())):
                wrong = {k: (one.get(k), other.get(k)) for k in one.keys() | other.keys() if one.get(k) != other.get(k)}
                listed.append(f"{name}, row {number}: {wrong or (sorted(one), sorted(other))}")
                break
    return listed


@pytest.fixture(scope="session")
def reference() -> Callable[..., Tables]:
    return expected_tables


@pytest.fixture(scope="session")
def rows() -> Callable[[Any], list[dict[str, Any]]]:
    return rows_of


@pytest.fixture(scope="session")
def differ() -> Callable[[Tables, Tables], list[str]]:
    return differences


@pytest.fixture(scope="session", params=CAPTURES)
def recording(request: pytest.FixtureRequest) -> tuple[Path, Codec]:
    """Each shared recording with its codec."""
    return ROOT / "captures" / request.param, get_codec(CAPTURES[request.param])


@pytest.fixture(scope="session")
def frames_of() -> Callable[[Path], list[Frame]]:
    def read(path: Path) -> list[Frame]:
        with open_capture(path) as reader:
            return list(reader)

    return read


@pytest.fixture(scope="session")
def odd_codec(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Codec]:
    folder = tmp_path_factory.mktemp("profiles")

    def make(name: str) -> Codec:
        if name != "odd-octets":
            return codec_of(name, folder)
        path = folder / f"{name}.toml"
        path.write_text(_LONG, encoding="utf-8")
        return Codec(path)

    return make


def pytest_generate_tests(metafunc: pytest.Metafunc) -> None:
    if "any_profile" in metafunc.fixturenames:
        core = ("dcp-2.0", "odd-areas", "odd-own")
        names = [*(each for each in NAMES if each not in core), "odd-octets"]
        metafunc.parametrize("any_profile", [*core, *also("tables", *names)])
