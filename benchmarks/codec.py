"""Measure decoding and encoding of beacons: our codec, construct, scapy, and ``struct`` by hand.

    python benchmarks/codec.py [DIRECTORY] [--seconds N] [--json FILE]

Every beacon of every recording in DIRECTORY (``captures`` beside this folder) is used. Before anything is measured, all
contenders have to give the same values and the same octets for every beacon. The contenders take turns, pass after
pass over the same beacons, so that a busy machine slows them all; the best pass of each counts for the ratios.
"""

from __future__ import annotations

import argparse
import gc
import json
import logging
import platform
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from statistics import median
from typing import Any

import construct
import msgspec
from rich.console import Console
from rich.table import Table

from dcp_codec import Beacon, Codec, DecodeError, get_codec
from dcp_codec.capture import open_capture
from dcp_codec.framing.locate import Framing, locate

sys.path.insert(0, str(Path(__file__).parent))
logging.getLogger("scapy").setLevel(logging.ERROR)

import handwritten  # noqa: E402 - the folder is not a package
import scapy_only  # noqa: E402

#: The layouts that scapy_only and handwritten know.
PROFILES = ("cpp-2.0", "cpp-1.3")
CAPTURES = Path(__file__).resolve().parent.parent / "captures"
SUFFIXES = (".mcap", ".pcap", ".pcapng")
#: Maximum number of passes of a fast contender over all beacons during one pass of a slow one.
MOST_TURNS = 25


@dataclass
class Recording:
    """The bearer payloads of one file, each with its padding, and the profile that they are of."""

    name: str
    profile: str
    beacons: list[bytes]


@dataclass
class Contender:
    """One way to do it. ``runs`` are (function, its argument for each beacon), one for each recording."""

    name: str
    runs: list[tuple[Callable[[Any], Any], list[Any]]]
    passes: list[float] = field(default_factory=list)

    def one_pass(self) -> None:
        """Go over all beacons once and note the seconds."""
        begin = time.perf_counter()
        for function, arguments in self.runs:
            for argument in arguments:
                function(argument)
        self.passes.append(time.perf_counter() - begin)


def read_recordings(directory: Path) -> list[Recording]:
    """All recordings of a folder."""
    found = []
    for path in sorted(path for path in directory.iterdir() if path.suffix in SUFFIXES):
        with open_capture(path) as capture:
            frames = [frame.data for frame in capture]
        payloads = [frame[framing.start : framing.end] for frame, framing in _beacons(frames)]
        found.append(Recording(path.name, _profile_of(path, payloads), payloads))
    if not found:
        raise SystemExit(f"{directory}: no recordings ({', '.join(SUFFIXES)})")
    return found


def _beacons(frames: Sequence[bytes]) -> Iterator[tuple[bytes, Framing]]:
    link = get_codec(PROFILES[0]).profile.link
    for frame in frames:
        framing = locate(frame, link)
        if isinstance(framing, Framing):
            yield frame, framing


def _profile_of(path: Path, payloads: Sequence[bytes]) -> str:
    """The layout in which every beacon decodes."""
    for name in PROFILES:
        try:
            for payload in payloads:
                get_codec(name).decode(payload)
        except DecodeError:
            continue
        return name
    raise SystemExit(f"{path}: is of neither {' nor '.join(PROFILES)}")


# -- everything as tuples, to be compared -----------------------------------------------------------------------


def tuples_of(beacon: Beacon) -> tuple[Any, ...]:
    """A value of the codec in the form that ``handwritten`` documents."""
    assert beacon.bp is not None
    payloads: list[tuple[int, Any]] = []
    for payload in beacon.payloads:
        content: Any = payload.content
        if payload.srp is not None:
            report = payload.srp
            data = report.s_data.as_dict().values()
            content = (*data, report.node_id, report.t_stamp, report.seqno, *report.extra)
        elif payload.vardis is not None:
            content = [(each.ic_type, [astuple(record) for record in each.records]) for each in payload.vardis]
        payloads.append((payload.protocol_id, content))
    return beacon.bp.sender_id, beacon.bp.seqno, beacon.bp.network_id, payloads


def astuple(record: Any) -> Any:
    """A record with everything in it as tuples."""
    return tuple(map(astuple, msgspec.structs.astuple(record))) if isinstance(record, msgspec.Struct) else record


def tuples_of_construct(parsed: Any) -> tuple[Any, ...]:
    """Convert the result of construct to the same form."""
    payloads = []
    for block in parsed.payloads:
        content = block.content
        if block.protocolId == handwritten.SRP:
            opaque = (content.opaque24, content.opaque38, content.opaque40, content.opaque60)
            data = content.sData
            content = (data.x, data.y, data.z, content.nodeId, content.tStamp, content.seqno, *opaque)
        elif block.protocolId == handwritten.VARDIS:
            content = [(each.icType, [_construct_record(record) for record in each.records]) for each in content]
        payloads.append((block.protocolId, content))
    return parsed.bp.senderId, parsed.bp.seqno, parsed.bp.get("networkId"), payloads


def _construct_record(record: Any) -> tuple[Any, ...]:
    if "spec" in record:
        spec, upd = record.spec, record.upd
        times = (spec.get("creationTime"), spec.get("timeout"))
        return (spec.varId, spec.prodId, spec.repCnt, spec.descr, *times), (upd.varId, upd.seqno, upd.value)
    return tuple(record[name] for name in ("varId", "seqno", "value") if name in record)


# -- contenders -------------------------------------------------------------------------------------------------

OURS = "dcp_codec"
CONSTRUCT = "construct"
SCAPY = "scapy"
BY_HAND_TUPLES = "by hand, tuples"
BY_HAND_VALUES = "by hand, values"


def contenders(recordings: Sequence[Recording]) -> tuple[list[Contender], list[Contender]]:
    """The decoders and the encoders with what they work on; asserts that all of them agree on every beacon."""
    names = (OURS, CONSTRUCT, SCAPY, BY_HAND_TUPLES, BY_HAND_VALUES)
    decoders = {name: Contender(name, []) for name in names}
    encoders = {name: Contender(name, []) for name in names}
    for recording in recordings:
        codec = get_codec(recording.profile)
        decode, encode = functions(codec)
        layer = scapy_only.Layer(recording.profile == "cpp-2.0")
        schema = codec.schema.beacon
        reference = [codec.decode(octets) for octets in recording.beacons]
        wanted = [tuples_of(beacon) for beacon in reference]
        as_tuples: dict[str, Callable[[Any], Any]] = {
            OURS: tuples_of,
            CONSTRUCT: tuples_of_construct,
            SCAPY: layer.as_tuples,
            BY_HAND_TUPLES: lambda beacon: beacon,
            BY_HAND_VALUES: tuples_of,
        }
        inputs: dict[str, list[Any]] = {
            OURS: reference,
            CONSTRUCT: [schema.parse(octets) for octets in recording.beacons],
            SCAPY: [layer.from_tuples(beacon) for beacon in wanted],
            BY_HAND_TUPLES: wanted,
            BY_HAND_VALUES: reference,
        }
        bare = [octets[: codec.decode_from(octets)[1]] for octets in recording.beacons]
        for name in names:
            for octets, value, value_in, expected in zip(recording.beacons, wanted, inputs[name], bare, strict=True):
                _same(name, recording, as_tuples[name](decode[name](octets)), value)
                _same(name, recording, encode[name](value_in), expected)
            decoders[name].runs.append((decode[name], recording.beacons))
            encoders[name].runs.append((encode[name], inputs[name]))
    return list(decoders.values()), list(encoders.values())


def functions(codec: Codec) -> tuple[dict[str, Callable[[Any], Any]], dict[str, Callable[[Any], Any]]]:
    """The decoding and the encoding function of each contender."""
    since_2_0 = codec.profile.name == "cpp-2.0"
    layout = handwritten.Layout(since_2_0, codec.safety_data_type)
    schema = codec.schema.beacon
    packet = scapy_only.Layer(since_2_0).beacon
    decode: dict[str, Callable[[Any], Any]] = {
        OURS: codec.decode,
        CONSTRUCT: schema.parse,
        SCAPY: packet,
        BY_HAND_TUPLES: lambda octets: handwritten.decode_tuples(octets, layout),
        BY_HAND_VALUES: lambda octets: handwritten.decode_values(octets, layout),
    }
    encode: dict[str, Callable[[Any], Any]] = {
        OURS: codec.encode,
        CONSTRUCT: schema.build,
        SCAPY: bytes,
        BY_HAND_TUPLES: lambda beacon: handwritten.encode_tuples(beacon, layout),
        BY_HAND_VALUES: lambda beacon: handwritten.encode_values(beacon, layout),
    }
    return decode, encode


def _same(name: str, recording: Recording, found: Any, expected: Any) -> None:
    if found != expected:
        raise SystemExit(f"{name} is wrong about a beacon of {recording.name}:\n{found}\ninstead of\n{expected}")


# -- measuring --------------------------------------------------------------------------------------------------


def measure(all_of_them: Sequence[Contender], seconds: float) -> None:
    """Let the contenders take turns for ``seconds``; in a round the quick ones have more turns than the slow ones."""
    for contender in all_of_them:
        contender.one_pass()
    slowest = max(contender.passes[0] for contender in all_of_them)
    turns = {contender.name: min(MOST_TURNS, round(slowest / contender.passes[0])) for contender in all_of_them}
    for contender in all_of_them:
        contender.passes.clear()
    end = time.perf_counter() + seconds
    while time.perf_counter() < end or not all_of_them[0].passes:
        for turn in range(MOST_TURNS):
            for contender in all_of_them:
                if turn < turns[contender.name]:
                    gc.collect()
                    gc.disable()
                    contender.one_pass()
                    gc.enable()


def report(kind: str, all_of_them: Sequence[Contender], beacons: int) -> list[dict[str, Any]]:
    """The figures of each contender: microseconds per beacon, best and median pass, and how they compare to ours."""
    ours = min(next(contender for contender in all_of_them if contender.name == OURS).passes)
    return [
        {
            "task": kind,
            "contender": contender.name,
            "best_us": min(contender.passes) / beacons * 1e6,
            "median_us": median(contender.passes) / beacons * 1e6,
            "ratio_to_ours": min(contender.passes) / ours,
            "passes": len(contender.passes),
        }
        for contender in all_of_them
    ]


def show(figures: Sequence[dict[str, Any]], recordings: Sequence[Recording]) -> None:
    """Print the figures as tables."""
    console = Console()
    total = sum(len(recording.beacons) for recording in recordings)
    octets = sum(map(len, (beacon for recording in recordings for beacon in recording.beacons)))
    console.print(f"{total} beacons of {len(recordings)} recordings, {octets / total:.0f} octets on average:")
    for recording in recordings:
        console.print(f"  {recording.name}: {len(recording.beacons)} ({recording.profile})")
    for kind in ("decode", "encode"):
        table = Table(title=f"{kind} one beacon", title_justify="left")
        table.add_column("contender")
        for heading in ("best µs", "median µs", "times ours", "passes"):
            table.add_column(heading, justify="right")
        for row in figures:
            if row["task"] == kind:
                numbers = (f"{row['best_us']:.2f}", f"{row['median_us']:.2f}", f"{row['ratio_to_ours']:.2f}")
                table.add_row(row["contender"], *numbers, str(row["passes"]))
        console.print(table)


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("directory", type=Path, nargs="?", default=CAPTURES, help="folder with recordings")
    parser.add_argument("--seconds", type=float, default=20.0, help="for decoding and encoding together")
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    arguments = parser.parse_args()

    recordings = read_recordings(arguments.directory)
    beacons = sum(len(recording.beacons) for recording in recordings)
    decoders, encoders = contenders(recordings)
    measure(decoders, arguments.seconds / 2)
    measure(encoders, arguments.seconds / 2)
    figures = report("decode", decoders, beacons) + report("encode", encoders, beacons)
    show(figures, recordings)
    if arguments.json is not None:
        about = {
            "python": platform.python_version(),
            "machine": platform.machine(),
            "construct": construct.__version__,
            "msgspec": msgspec.__version__,
            "beacons": beacons,
            "recordings": {recording.name: recording.profile for recording in recordings},
        }
        arguments.json.write_text(json.dumps({**about, "figures": figures}, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
