"""Recordings of a cell: everything that was transmitted, and what each station sent and received."""

from __future__ import annotations

import re
import shutil
from pathlib import Path

import msgspec
from dcp_conformance.reporting.recordings import write_frames

from dcp_codec.capture import Frame

from .judge import frames_of
from .results import CellResult
from .world import Received, Sent, World


def write_recordings(result: CellResult, world: World, folder: Path) -> CellResult:
    """Write ``all.mcap`` and ``place-N.mcap``; returns the result with their names, relative to ``folder``.

    Raises ``UsageError`` if a file cannot be written.
    """
    parts = ("cells", result.a, result.b, result.test)
    name = "/".join(re.sub(r"[^A-Za-z0-9._@+=-]", "_", each) for each in parts)
    directory = folder / name
    directory.mkdir(parents=True, exist_ok=True)
    sent = world.sent()
    _write(directory / "all.mcap", frames_of(world, sent), result, "all links")
    stations = []
    logs = world.logs()
    for station in result.stations:
        made = world.recordings().get(station.place)
        if made is not None and made.is_file():
            shutil.copyfile(made, directory / f"place-{station.place}.mcap")
        else:
            _write_place(directory, world, station.place, result)
        log = Path(logs[station.place]) if station.place in logs else None
        if log is not None and log.is_file():
            text = log.read_text(errors="replace")
            (directory / f"place-{station.place}.log").write_text(text)
        stations.append(
            msgspec.structs.replace(
                station,
                recording=f"{name}/place-{station.place}.mcap",
                log=f"{name}/place-{station.place}.log" if log is not None and log.is_file() else "",
            )
        )
    return msgspec.structs.replace(result, stations=tuple(stations), recording=f"{name}/all.mcap")


def _write_place(directory: Path, world: World, place: int, result: CellResult) -> None:
    both: list[Sent | Received] = [each for each in world.sent() if each.place == place]
    both += [each for each in world.received() if each.place == place]
    both.sort(key=lambda each: each.time)
    _write(directory / f"place-{place}.mcap", frames_of(world, both), result, f"place {place}")


def _write(path: Path, frames: list[Frame], result: CellResult, link: str) -> None:
    about = {
        "dcp.interop": {
            "cell": f"{result.a}:{result.b}:{result.test}",
            "link": link,
            "profile": result.profile,
            "seed": str(result.seed),
            "command": result.rerun,
        }
    }
    write_frames(path, frames, about)
