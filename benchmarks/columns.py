"""Measure columnar decoding from file to columns, beside everything else that reads the same beacons.

    python benchmarks/columns.py [RECORDING...] [--beacons N] [--rounds N] [--json FILE]

Each RECORDING (those of ``captures/``, ``b_crud.mcap`` first) is repeated to at least N beacons in a temporary folder;
the files are read once before anything is measured, so that they are in the page cache. In each round the contenders
take turns, all on the same core; with the first recording all contenders, with the others the decoders and encoders.
The result is the CPU time of each contender in its best round. Slow contenders get the first part of a recording,
stated as ``beacons``; the start of a program is not counted (tshark: the time for one frame is subtracted). Ratios are
those of beacons per second, to columnar decoding of the same recording. In the end two processes on two cores do the
work of one, and the tables of one recording are made with all cores, in wall time.
"""

from __future__ import annotations

import argparse
import json
import logging
import multiprocessing
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
from dcp_tables import ColumnDecoder, Recording
from dcp_tables.table.archive import Order, make
from dcp_tables.table.writing import Format

from dcp_codec import Codec, get_codec, open_table
from dcp_codec.capture import open_capture
from dcp_codec.export.lua import wireshark_dissector
from dcp_codec.framing.locate import Framing, locate

sys.path.insert(0, str(Path(__file__).parent))
logging.getLogger("scapy").setLevel(logging.ERROR)

import handwritten  # noqa: E402 - the folder is not a package
import scapy_only  # noqa: E402
from columns_report import COLUMNAR, Contender, figures, show  # noqa: E402
from repeated import SLOW, Formats, Material  # noqa: E402

CAPTURES = Path(__file__).resolve().parent.parent / "captures"
RECORDINGS = [CAPTURES / f"{name}.mcap" for name in ("b_crud", "a_bus3", "a_bus3_v1.3.6", "c_latejoin")]
#: Beacons that contenders get which need hundreds of microseconds for each.
SLOWEST = 4_000
#: The layouts that the contenders written by hand know.
BY_HAND = ("cpp-2.0", "cpp-1.3")
#: Contenders measured in wall time as well, with all cores.
WAITED_FOR = (COLUMNAR, "columnar, MCAP", "tables, Parquet")
#: Fields that tshark writes: much of what the tables hold.
_RECORD = "dcp.payloads.vardis.records"
FIELDS = ("frame.number", "frame.time_epoch", "dcp.bp.senderId", "dcp.bp.seqno", "dcp.payloads.vardis.icType")
FIELDS += tuple(f"{_RECORD}.{name}" for name in ("varId", "seqno", "spec.varId", "upd.seqno", "upd.value"))


# -- contenders ---------------------------------------------------------------------------------------------------


def columnar(path: Path, decoder: ColumnDecoder) -> int:
    """Decode a file to columns."""
    beacons = 0
    with Recording(path) as recording:
        for block in recording.blocks():
            for batch in decoder.batches(block):
                beacons += batch.tables["beacons"].num_rows
        assert not recording.problems
    return beacons


def opened(path: Path, codec: Codec) -> int:
    """One table of a file as Arrow has it."""
    rows: int = open_table(path, "beacons", profile=codec.profile.name).arrow().num_rows
    return rows


def scalar_file(path: Path, codec: Codec) -> int:
    """Read and decode a file beacon by beacon."""
    beacons, link = 0, codec.profile.link
    with open_capture(path) as reader:
        for frame in reader:
            framing = locate(frame.data, link)
            if isinstance(framing, Framing):
                codec.decode_from(frame.data[: framing.end], framing.start)
                beacons += 1
    return beacons


def read_file(path: Path) -> int:
    """Read the frames of a file, and nothing else."""
    with open_capture(path) as reader:
        return sum(1 for _ in reader)


def each(function: Callable[[Any], Any], items: Sequence[Any]) -> Callable[[], int]:
    """Call ``function`` for every item."""

    def run() -> int:
        for item in items:
            function(item)
        return len(items)

    return run


def numpy_copy(path: Path, beacons: int) -> int:
    """Copy the whole file into fresh memory."""
    np.array(np.memmap(path, np.uint8, "r"))
    return beacons


def to_files(path: Path, folder: Path, profile: str, form: Format = "parquet") -> int:
    """All tables of a file as files."""
    out = folder / "tables"
    (outcome,) = make(Order((str(path),), out, form, profile=profile, force=True))
    shutil.rmtree(out)
    return outcome.rows["beacons"]


def tshark(path: Path, script: Path, count: int) -> int:
    """tshark with our dissector, writing fields."""
    home = script.parent / "home"
    home.mkdir(exist_ok=True)
    environment = {**os.environ, "HOME": str(home), "XDG_CONFIG_HOME": str(home)}
    fields = [part for name in FIELDS for part in ("-e", name)]
    command = ["tshark", "-n", "-X", f"lua_script:{script}", "-r", str(path), "-c", str(count), "-T", "fields", *fields]
    done = subprocess.run(command, capture_output=True, env=environment, check=True)
    return done.stdout.count(b"\n")


def coders(material: Material, decoder: ColumnDecoder) -> list[Contender]:
    """Our own decoders and encoders, without files of other formats."""
    codec, beacons, octets, values = material.codec, material.beacons, material.octets, material.values
    return [
        Contender(COLUMNAR, "file to columns", beacons, lambda: columnar(material.pcap, decoder)),
        Contender("scalar decode", "octets to values", len(octets), each(codec.decode, octets)),
        Contender("scalar encode", "values to octets", len(values), each(codec.encode, values)),
    ]


def files(material: Material, formats: Formats, decoder: ColumnDecoder, folder: Path) -> list[Contender]:
    """From files of every format to columns, files and values."""
    codec, beacons, pcap = material.codec, material.beacons, material.pcap
    profile, part, whole = codec.profile.name, formats.beacons, formats.whole_beacons
    return [
        Contender("numpy copy", "the file copied into memory", beacons, lambda: numpy_copy(pcap, beacons)),
        Contender("open_table", "file to an Arrow table of beacons", beacons, lambda: opened(pcap, codec)),
        Contender("columnar, pcapng", "file to columns", part, lambda: columnar(formats.pcapng, decoder)),
        Contender("columnar, MCAP", "zstd, file to columns", whole, lambda: columnar(formats.whole_mcap, decoder)),
        Contender("columnar, plain MCAP", "file to columns", whole, lambda: columnar(formats.whole_plain, decoder)),
        Contender("tables, Parquet", "pcap to files", beacons, lambda: to_files(pcap, folder, profile)),
        Contender("tables, Parquet", "MCAP to files", whole, lambda: to_files(formats.whole_mcap, folder, profile)),
        Contender("tables, CSV", "pcap to files", part, lambda: to_files(formats.pcap, folder, profile, "csv")),
        Contender("MCAP read", "file to frames", part, lambda: read_file(formats.mcap)),
        Contender("pcap read", "file to frames", part, lambda: read_file(formats.pcap)),
        Contender("pcapng read", "file to frames", part, lambda: read_file(formats.pcapng)),
        Contender("scalar, pcap", "file to values", part, lambda: scalar_file(formats.pcap, codec)),
    ]


def others(material: Material, folder: Path) -> list[Contender]:
    """Other decoders of the same beacons: code written by hand, scapy, construct, tshark."""
    codec, octets, values = material.codec, material.octets, material.values
    few, many = octets[:SLOWEST], len(octets)
    found = []
    if codec.profile.name in BY_HAND:
        since_2_0 = codec.profile.name == "cpp-2.0"
        layout = handwritten.Layout(since_2_0, codec.safety_data_type)
        packet = scapy_only.Layer(since_2_0).beacon
        found += [
            Contender(
                "struct by hand, values",
                "octets to values",
                many,
                each(lambda one: handwritten.decode_values(one, layout), octets),
            ),
            Contender(
                "struct by hand, tuples",
                "octets to tuples",
                many,
                each(lambda one: handwritten.decode_tuples(one, layout), octets),
            ),
            Contender(
                "struct by hand, encode",
                "values to octets",
                many,
                each(lambda one: handwritten.encode_values(one, layout), values),
            ),
            Contender("scapy", "octets to packets", len(few), each(packet, few)),
        ]
    found.append(Contender("construct", "octets to containers", len(few), each(codec.schema.beacon.parse, few)))
    if shutil.which("tshark"):
        script = folder / "dcp.lua"
        script.write_text(wireshark_dissector(codec), encoding="utf-8")
        pcap, count = material.pcap, min(SLOW, material.beacons)
        found.append(Contender("tshark", "file to fields", count, lambda: tshark(pcap, script, count)))
        found.append(Contender("tshark, one frame", "its start", 1, lambda: tshark(pcap, script, 1)))
    return found


def contenders(materials: Sequence[Material], folder: Path) -> list[Contender]:
    """All contenders with the first recording, our coders with the others."""
    found = []
    for material in materials:
        decoder = ColumnDecoder(material.codec, material.link)
        taking_part = coders(material, decoder)
        if material is materials[0]:
            taking_part += files(material, Formats(material, folder), decoder, folder)
            taking_part += others(material, folder)
        for one in taking_part:
            one.of = material.name
        found += taking_part
    return found


# -- cores --------------------------------------------------------------------------------------------------------


class Worker:
    """A process that decodes; it has compiled everything before it is measured."""

    decoder: ColumnDecoder | None = None

    @classmethod
    def decode(cls, path: str, profile: str) -> int:
        """Decode a file to columns."""
        if cls.decoder is None:
            cls.decoder = ColumnDecoder(get_codec(profile))
        return columnar(Path(path), cls.decoder)

    @staticmethod
    def tables(path: str, profile: str) -> int:
        """All tables of a file as Parquet, beside each other."""
        with tempfile.TemporaryDirectory(dir=Path(path).parent) as folder:
            return to_files(Path(path), Path(folder), profile)

    @staticmethod
    def spin(_path: str, _profile: str) -> int:
        """Do nothing for about as long, without memory: what the machine has to give."""
        return sum(number & 1 for number in range(4_000_000))


def over_cores(material: Material, rounds: int) -> dict[str, float]:
    """Speed of two processes relative to one, with two files: decoding, tables, and a busy loop for comparison.

    Of the best rounds. On a busy machine the busy loop gains little: then the other figures are too low as well.
    """
    jobs = [(str(material.pcap), material.codec.profile.name)] * 2
    works: dict[str, Callable[[str, str], int]] = {
        "columnar": Worker.decode,
        "tables, Parquet": Worker.tables,
        "spinning": Worker.spin,
    }
    seconds: dict[tuple[str, int], list[float]] = {(name, n): [] for name in works for n in (1, 2)}
    context = multiprocessing.get_context("spawn")
    # Each has one core, or one process would write tables with the core of the other.
    one, other = sorted(os.sched_getaffinity(0))[:2]
    with (
        ProcessPoolExecutor(1, context, os.sched_setaffinity, (0, {one})) as single,
        ProcessPoolExecutor(1, context, os.sched_setaffinity, (0, {other})) as second,
    ):
        for pool in (single, second):
            pool.submit(Worker.decode, *jobs[0]).result()
        for _ in range(rounds):
            for name, work in works.items():
                for number, pools in ((1, (single, single)), (2, (single, second))):
                    begin = time.perf_counter()
                    futures = [pool.submit(work, *job) for pool, job in zip(pools, jobs, strict=True)]
                    for future in futures:
                        future.result()
                    seconds[name, number].append(time.perf_counter() - begin)
    return {name: min(seconds[name, 1]) / min(seconds[name, 2]) for name in works}


def waiting(found: Sequence[Contender], rounds: int) -> dict[str, float]:
    """How long people wait for the tables of one recording, by the clock, with all cores: times of "file to columns".

    The contenders take turns, and the best rounds count. On a machine that has other things to do threads gain little.
    """
    taking_part = [one for one in found if one.name in WAITED_FOR and one.of == found[0].of]
    seconds: dict[str, list[float]] = {}
    for _ in range(rounds):
        for one in taking_part:
            begin = time.perf_counter()
            one.run()
            seconds.setdefault(f"{one.name}, {one.what}", []).append(time.perf_counter() - begin)
    columns = min(seconds[f"{COLUMNAR}, file to columns"])
    return {name: min(each) / columns for name, each in seconds.items()}


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("recordings", type=Path, nargs="*", default=RECORDINGS)
    parser.add_argument("--beacons", type=int, default=2_000_000, help="at least so many")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path, help="also write the figures to this file")
    given = parser.parse_args()
    cores = os.sched_getaffinity(0)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        # One core for all that take turns, whatever threads and processes they have.
        os.sched_setaffinity(0, {max(cores)})
        materials = [Material(recording, given.beacons, folder) for recording in given.recordings]
        found = contenders(materials, folder)
        # Once for everything that is only done once: compiling, the page cache, imports.
        for one in found:
            one.turn()
            one.seconds.clear()
        for _ in range(given.rounds):
            for one in found:
                one.turn()
        os.sched_setaffinity(0, cores)
        ratios = over_cores(materials[0], given.rounds) if len(cores) > 1 else None
        waits = waiting(found, given.rounds)
        rows = figures(found)
        show(materials, rows, ratios, waits)
    if given.json is not None:
        about = {
            "python": platform.python_version(),
            "machine": platform.machine(),
            "recordings": {
                material.name: {"beacons": material.beacons, "octets": material.size} for material in materials
            },
            "figures": rows,
            "two_cores": ratios,
            "waiting": waits,
        }
        given.json.write_text(json.dumps(about, indent=2) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
