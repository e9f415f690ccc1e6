"""Judge a recording file: choose its profile, estimate its beacon period, and pass its frames to the judge."""

from __future__ import annotations

import contextlib
import itertools
import statistics
from collections.abc import Callable, Sequence
from pathlib import Path

import msgspec
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import ProfileError, load_profile
from dcp_spec.profile.usability import unusable_keys

from dcp_codec.analysis.guess import Guess, guess, sample
from dcp_codec.capture import CaptureError, open_capture
from dcp_codec.capture.frame import Frame
from dcp_codec.cli.common import progress
from dcp_codec.codec import Codec
from dcp_codec.common.commandline import say
from dcp_codec.common.garbage import few_collections
from dcp_codec.common.workers import WorkerLostError
from dcp_codec.framing.ethertype import parse_ether_type
from dcp_codec.framing.frames import with_ether_type
from dcp_codec.framing.locate import OtherTraffic, locate
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import RunResult
from dcp_conformance.errors import UsageError
from dcp_conformance.frames.received import ReceivedBeacon

from .judge import OF_REACTIONS, Judge, Task, tasks
from .sharing import Helper, processes
from .tables import write_tables
from .topology import Topology
from .versions import Versions, undecided, weakness

#: Number of frames at the start of a recording from which the beacon period is estimated, and the minimum number of
#: intervals of a sender.
_LOOKED_AT, _ENOUGH = 5_000, 10


def judge_versions(
    path: Path,
    profile: str | None,
    pics: Pics,
    *,
    ether_type: str | None = None,
    command: str = "",
    period_known: bool = False,
    show_progress: bool = False,
    name_damage: bool = False,
    topology: Topology | None = None,
    tables: Path | None = None,
    jobs: int | None = None,
) -> list[tuple[RunResult, Codec]]:
    """Judge one recording; return the result and the codec that decoded it, two of them for beacons of two versions.

    ``profile``: name or file of a profile; None for the one in ``pics``, or else a guess. ``ether_type``: replaces the
    EtherType of the profile. ``period_known``: the beacon period in ``pics`` is that of the network; False: estimate
    it from the recording. ``show_progress``: show a progress bar on standard error if that is a terminal and the file
    is long.

    Each frame is judged by the profile of its version, together with the other frames of that version only. If the
    profile is a weak guess, every verdict is replaced by inconclusive. ``name_damage``: print on standard error what
    cannot be read of the file; the notes of the results have it, too. ``topology``: the links that the user tells.
    ``tables``: a folder for the tables of the ledger. ``jobs``: number of processes, 1 to 3; None: as many for a long
    file as there are processors.

    Raises :class:`UsageError` if the file or the profile does not exist, or the file is not a capture or has no DCP
    frames.
    """
    found, judges, notes = judges_of(
        path, profile, pics, ether_type=ether_type, command=command, period_known=period_known,
        show_progress=show_progress, topology=topology, jobs=jobs,
    )  # fmt: skip
    for each in notes if name_damage else ():
        say(f"{path}: {each}", err=True)
    results = [(judge.result([*found.notes, *notes]), judge.codec) for judge in judges]
    if tables is not None:
        for judge, (run, codec) in zip(judges, results, strict=True):
            write_tables(judge, run, tables if len(judges) == 1 else tables / codec.profile.name)
    return [(undecided(run, found.weakness), codec) for run, codec in results] if found.weakness else results


def judges_of(
    path: Path,
    profile: str | None,
    pics: Pics,
    *,
    ether_type: str | None = None,
    command: str = "",
    period_known: bool = False,
    show_progress: bool = False,
    topology: Topology | None = None,
    jobs: int | None = None,
    all_rules: bool = True,
) -> tuple[_Choice, list[Judge], list[str]]:
    """Read a recording; return the profile, the judges that have received the frames, and notes about damage.

    There are two judges if the recording has beacons of two versions. ``jobs``: as in :func:`judge_versions`.
    ``all_rules``: False: apply only the rules about reactions. Raises :class:`UsageError` as :func:`judge_versions`
    does.
    """
    found = _Choice(path, profile or pics.pixit.profile, ether_type)
    codecs = [found.codec, *([found.other] if found.other is not None else [])]
    versions = Versions(codecs[0], codecs[1]) if len(codecs) > 1 else None
    periods = [pics if period_known else _with_period(pics, _period(path, codec)) for codec in codecs]
    # File names are octets: make them valid Unicode, so that the report can be written.
    name = path.name.encode("utf-8", "backslashreplace").decode()

    def judges_for(task: Task) -> list[Judge]:
        return [
            Judge(
                codec, each, recording=name, path=str(path), command=command, period_known=period_known,
                topology=topology, task=task,
            )
            for codec, each in zip(codecs, periods, strict=True)
        ]  # fmt: skip

    def feeder(judges: Sequence[Judge]) -> Callable[[Frame], None]:
        if versions is None:
            return judges[0].feed
        return lambda frame: judges[versions.of(frame)].feed(frame)

    mine, *others = tasks(processes(path, jobs)) if all_rules else [Task(OF_REACTIONS)]
    judges = judges_for(mine)
    with contextlib.ExitStack() as stack:
        helpers = [Helper(path, judges_for(each), feeder) for each in others]
        for helper in helpers:
            stack.callback(helper.end)
        try:
            with open_capture(path) as reader:
                with progress(reader, str(path), show=show_progress) as advance, few_collections():
                    feed = feeder(judges)
                    for frame in reader:
                        feed(frame)
                        advance()
                notes = [problem.message for problem in reader.problems]
            for helper in helpers:
                for judge, share in zip(judges, helper.shares(), strict=True):
                    judge.adopt(share)
        except (CaptureError, WorkerLostError) as error:
            raise UsageError(f"{path}: {error}" if isinstance(error, WorkerLostError) else str(error)) from None
    if not any(judge.frames for judge in judges):
        raise UsageError(f"{path}: none of its {judges[0].other} frames is DCP in the profile {codecs[0].profile.name}")
    return found, [judge for judge in judges if judge.frames], notes


class _Choice:
    """The codec that decodes a recording, and notes about its choice."""

    def __init__(self, path: Path, profile: str | None, ether_type: str | None) -> None:
        self.notes: list[str] = []
        self.other: Codec | None = None
        """Codec of a second version in the recording; None if there is only one."""
        self.weakness = ""
        """Why the guessed profile is too uncertain for verdicts; empty if it is certain enough, or was named."""
        if profile is not None:
            self.codec, self.notes = _codec(profile, ether_type)
            return
        found = _guessed(path, _number(ether_type))
        self.codec = Codec(msgspec.structs.replace(found.best.profile, link=found.best.link))
        if not found.certain:
            self.notes.append(f"the profile was guessed: {found}")
        self.weakness = weakness(found, path)
        if not self.weakness:
            _warn(path, found)
        if found.besides is not None and not self.weakness:
            candidate, _ = found.besides
            self.other = Codec(msgspec.structs.replace(candidate.profile, link=candidate.link))


def _period(path: Path, codec: Codec) -> float | None:
    """Return the longest beacon period of all senders in ms, estimated from the first frames; None without enough."""
    last: dict[bytes, ReceivedBeacon] = {}
    intervals: dict[bytes, list[float]] = {}
    try:
        with open_capture(path) as reader:
            for frame in itertools.islice(reader, _LOOKED_AT):
                framing = locate(frame.data, codec.profile.link)
                if isinstance(framing, OtherTraffic):
                    continue
                octets = frame.data[framing.start : framing.end]
                heard = ReceivedBeacon(codec, frame.number, frame.time_ns, frame.time_ns, octets, framing.src or b"")
                who = heard.sender or heard.source
                before = last.get(who)
                last[who] = heard
                if before is not None and (before.seqno is None or heard.seqno == before.seqno + 1):
                    intervals.setdefault(who, []).append((heard.time - before.time) / 1e6)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    return max((statistics.median(each) for each in intervals.values() if len(each) >= _ENOUGH), default=None)


def _with_period(pics: Pics, period: float | None) -> Pics:
    """Return ``pics`` with this beacon period in ms; unchanged if it is None or not positive."""
    if period is None or period <= 0:
        return pics
    return msgspec.structs.replace(pics, pixit=msgspec.structs.replace(pics.pixit, beacon_period_ms=period))


def _codec(profile: str, ether_type: str | None) -> tuple[Codec, list[str]]:
    """Return the codec of the profile that the user named, and an empty list of notes. Raises :class:`UsageError`."""
    number = _number(ether_type)
    try:
        codec = Codec(profile)
    except ProfileError as error:
        raise UsageError(str(error)) from None
    _refuse_own_records(codec.profile)
    if number is None:
        return codec, []
    link = with_ether_type(codec.profile.link, number)
    return Codec(msgspec.structs.replace(codec.profile, link=link)), []


def _refuse_own_records(profile: Profile) -> None:
    """Raise :class:`UsageError` if a profile changes the VarDis records: the rules need those of the specification."""
    keys = unusable_keys(profile)
    own = {key: reason for key, reason in keys.items() if key.startswith("vardis.records.")}
    standard = load_profile(f"dcp-{profile.spec_version}").vardis.own_containers
    if names := ", ".join(each.name for each in profile.vardis.own_containers if each not in standard):
        own["vardis.own_containers"] = f"has {names}"
    if own:
        told = ", ".join(f"{key} {reason.partition(';')[0]}" for key, reason in own.items())
        raise UsageError(
            f"profile {profile.name}: check has rules for the records of the specification only ({told}). "
            "To decode such a recording, use dcp-codec"
        )


def _number(ether_type: str | None) -> int | None:
    """Parse the option ``--ether-type``. Raises :class:`UsageError`."""
    try:
        return None if ether_type is None else parse_ether_type(ether_type)
    except ValueError as error:
        raise UsageError(f"--ether-type: {error}") from None


def guessed_profile(path: Path) -> str:
    """Return the name of the profile that fits a recording best. Raises :class:`UsageError`."""
    found = _guessed(path)
    _warn(path, found)
    return found.best.profile.name


def _warn(path: Path, found: Guess) -> None:
    """Print a warning about a weak guess: verdicts by a profile that does not fit mean nothing."""
    if found.warning is not None:
        say(f"{path}: {found.warning}: name one with --profile, or see dcp-codec guess {path}", err=True)


def _guessed(path: Path, ether_type: int | None = None) -> Guess:
    """Guess profile and link of a recording. Raises :class:`UsageError` if it has no frames that could be DCP."""
    try:
        with open_capture(path) as reader:
            first, _ = sample(iter(reader), ether_type=ether_type)
            damage = "; ".join(problem.message for problem in reader.problems)
    except CaptureError as error:
        raise UsageError(str(error)) from None
    if not first:
        raise UsageError(f"{path}: the recording has no frames" + (f": {damage}" if damage else ""))
    found = guess(first, ether_type=ether_type)
    if not found.best.frames:
        where = "the EtherTypes and ports of the built-in profiles" if ether_type is None else f"0x{ether_type:04x}"
        raise UsageError(
            f"{path}: cannot determine the profile: no frames with {where}; dcp-codec stats shows what the file has"
        )
    return found
