"""Open the link, upper tester and process control of the implementation under test, according to the user's options."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import msgspec
from dcp_spec.profile.definition import Profile
from dcp_spec.profile.loading import ProfileError
from dcp_spec.profile.usability import refusal

from dcp_codec.codec import Codec
from dcp_codec.framing.frames import with_ether_type
from dcp_conformance.definitions.case import cases_of
from dcp_conformance.definitions.node_id import node_id_octets
from dcp_conformance.definitions.pics import DEFAULT_PROFILE, UNKNOWN_PROFILE, Pics, load_pics
from dcp_conformance.errors import ConformanceError, NoListenerError, UpperTesterError, UsageError
from dcp_conformance.impaired_link import impaired, parse_directions
from dcp_conformance.lower_tester import LowerTester
from dcp_conformance.sut.control import SutControl
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester import Reconnecting, UpperTester

from .runner import Runner
from .survival.life import START_PATIENCE

if TYPE_CHECKING:
    from dcp_conformance.sut.process import ProcessControl

#: Beacon period in ms of the reference node in a process: short, because all waits are multiples of it, and no other
#: node is on its link.
OWN_PERIOD = 20.0
#: Tolerated variation of the delays of an impaired link, as a share of the beacon period: that of cases on intervals.
_USUAL_DELAY = 0.02
#: Timeout of a call of the upper tester in seconds.
UPPER_PATIENCE = 5.0
#: Time in ns in which a node that runs already answers.
_ANSWER_NS = 1_000_000_000


@dataclass(frozen=True, slots=True)
class TargetOptions:
    """The implementation under test and its interfaces. Default: the reference node in a separate process."""

    profile: str | None = None
    interface: str | None = None
    ether_type: int | None = None
    link: str | None = None
    """``udp[:GROUP:PORT]``."""
    in_process: bool = False
    ut: str | None = None
    """``unix:PATH``, ``tcp:HOST:PORT``, ``exec:COMMAND``, ``commands:FILE``."""
    pics: Path | None = None
    start: str | None = None
    stop: str | None = None
    """Command that stops the implementation; only from the PICS file."""
    restart: str | None = None
    pid: int | None = None
    start_timeout: float | None = None
    """Timeout of the first answer after a start in seconds, from the PICS file; None: 30, or less if it opens the link
    but stays silent."""
    beacon_period_ms: float | None = None
    timing_scale: float = 1.0
    seed: int = 1
    impair: tuple[str, ...] = ()
    """Impairment of the link, see ``impairment.parse_directions``."""
    output: Path | None = None
    """File for the output of an implementation that is started; None: only its last lines are kept."""
    node_id: bytes | None = None
    """Node identifier of the reference node."""
    node_options: tuple[str, ...] = field(default=())
    """Further arguments of ``dcp-node run`` for the reference node in a process."""

    @property
    def foreign(self) -> bool:
        """Whether the implementation is not the reference node."""
        return self.interface is not None or self.link is not None

    def with_access(self) -> TargetOptions:
        """Return the options, completed by ``[access]`` of the PICS file. Raises :class:`UsageError`."""
        if self.pics is None or self.in_process:
            return self
        access = {name: value for name, value in msgspec.structs.asdict(load_pics(self.pics).access).items() if value}
        if self.foreign:
            access |= {"interface": None, "link": None}
        elif {"interface", "link"} <= access.keys():
            raise UsageError(f"{self.pics}: access: give interface or link, not both")
        return replace(self, **{name: value for name, value in access.items() if getattr(self, name) is None})

    def command_line(self) -> str:
        """Return the options as a command line without cases, for repeating a case."""
        import shlex

        words = ["dcp-conformance", "run"]
        if self.in_process:
            words.append("--in-process")
        for name in ("profile", "interface", "link", "ut", "pics", "start", "restart", "pid"):
            value = getattr(self, name)
            if value is not None:
                words += [f"--{name}", str(value)]
        if self.ether_type is not None:
            words += ["--ether-type", f"{self.ether_type:#06x}"]
        if self.beacon_period_ms is not None:
            words += ["--beacon-period", exact(self.beacon_period_ms)]
        if self.timing_scale != 1.0:
            words += ["--timing-scale", exact(self.timing_scale)]
        if self.seed != 1:
            words += ["--seed", str(self.seed)]
        for each in self.impair:
            words += ["--impair", each]
        return shlex.join(words)


def exact(number: float) -> str:
    """Return the shortest text of a number that has the same value."""
    short = f"{number:g}"
    return short if float(short) == number else repr(number)


@dataclass(slots=True)
class Target:
    """An opened implementation with its runner."""

    codec: Codec
    pics: Pics
    runner: Runner
    notes: list[str]


def describe(options: TargetOptions) -> tuple[Codec, Pics]:
    """Return codec and PICS of the options without opening any connection.

    Raise :class:`UsageError` for invalid or contradictory options.
    """
    parse_directions(options.impair)
    if options.in_process and options.foreign:
        raise UsageError("--in-process tests the reference node; it needs no --interface or --link")
    for name in () if options.foreign else ("ut", "start", "stop", "restart", "pid"):
        if getattr(options, name) is not None:
            raise UsageError(f"--{name} is for your own implementation: give its --interface or --link")
    pics = load_pics(options.pics) if options.pics is not None else Pics()
    name = options.profile or pics.pixit.profile or DEFAULT_PROFILE
    if name == UNKNOWN_PROFILE:
        raise UsageError(
            f"{options.pics}: pixit.profile: probe could not determine the wire profile of the implementation; "
            "write it there, or give --profile"
        )
    try:
        codec = Codec(name)
    except ProfileError as error:
        raise UsageError(str(error)) from None
    refuse_unusable(codec.profile)
    _check_node_id(options, pics, codec)
    if options.ether_type is not None:
        link = with_ether_type(codec.profile.link, options.ether_type)
        codec = Codec(msgspec.structs.replace(codec.profile, link=link))
    if options.beacon_period_ms is not None:
        pixit = msgspec.structs.replace(pics.pixit, beacon_period_ms=options.beacon_period_ms)
        pics = msgspec.structs.replace(pics, pixit=pixit)
    return codec, pics


def refuse_unusable(profile: Profile) -> None:
    """Raise :class:`UsageError` for a profile with fields or containers that the suite cannot fill meaningfully."""
    if (reason := refusal(profile)) is not None:
        raise UsageError(reason)


def _check_node_id(options: TargetOptions, pics: Pics, codec: Codec) -> None:
    """Reject node identifiers that do not fit the profile."""
    profile = codec.profile
    text, width = pics.pixit.node_id, profile.types.node_id.width
    # The width 0 means identifiers of variable length.
    if text is not None and width and (octets := len(node_id_octets(text))) != width:
        wrong = f"it has {octets} octets, in the profile {profile.name} it has {width}"
        raise UsageError(f"{options.pics}: pixit.node_id: {text!r}: {wrong}")


@contextlib.contextmanager
def open_target(options: TargetOptions) -> Iterator[Target]:
    """Open link, upper tester and process control, and close them at the end of the block.

    Raise :class:`UsageError` for contradictory options, and ``LowerTesterError`` or ``UpperTesterError`` if a
    connection cannot be opened.
    """
    if not (options.foreign or options.in_process or options.beacon_period_ms):
        options = replace(options, beacon_period_ms=OWN_PERIOD)
    codec, pics = describe(options)
    with contextlib.ExitStack() as stack:
        if options.in_process:
            session, control, notes = _in_process(options, codec, pics)
        elif options.foreign:
            session, control, notes = _foreign(options, codec, pics, stack)
        else:
            session, control, notes = _own_node(options, codec, pics, stack)
        stack.callback(session.lower.close)
        if session.upper is not None:
            stack.callback(session.upper.close)
        if options.foreign and options.profile is None and pics.pixit.profile is None:
            notes.append(f"neither --profile nor pixit.profile names the wire profile: {DEFAULT_PROFILE} is assumed")
        runner = Runner(session, control, rerun=options.command_line(), start_timeout=options.start_timeout)
        runner.remarks += notes
        yield Target(codec, pics, runner, notes)


def _session(
    options: TargetOptions, codec: Codec, pics: Pics, lower: LowerTester, upper: UpperTester | None
) -> Session:
    tolerance = round(pics.pixit.beacon_period_ms * 1e6 * _USUAL_DELAY)
    lower = impaired(lower, parse_directions(options.impair), seed=options.seed, tolerance=tolerance)
    return Session(codec, lower, upper, pics, timing_scale=options.timing_scale, seed=options.seed)


_Opened = tuple[Session, SutControl | None, list[str]]


def _in_process(options: TargetOptions, codec: Codec, pics: Pics) -> _Opened:
    from dcp_conformance.reference.inprocess import NODE_ID, InProcess, reference_config

    period = round(pics.pixit.beacon_period_ms)
    sut = InProcess(
        reference_config(codec, beacon_period_ms=period, node_id=options.node_id or NODE_ID), seed=options.seed
    )
    session = _session(options, codec, pics, sut.lower_tester(), sut.upper_tester())
    return session, sut, ["our own node in this process, in virtual time"]


def _own_node(options: TargetOptions, codec: Codec, pics: Pics, stack: contextlib.ExitStack) -> _Opened:
    from dcp_conformance.reference.process import NODE_ID, reference_process

    period = pics.pixit.beacon_period_ms
    node = stack.enter_context(
        reference_process(
            codec,
            beacon_period_ms=period,
            profile=options.profile,
            node_id=options.node_id or NODE_ID,
            options=options.node_options,
            patience=_patience(pics),
        )
    )
    session = _session(options, codec, pics, node.lower, node.upper)
    return session, node.control, [node.about]


def _patience(pics: Pics) -> float:
    """Return the timeout of a call of the upper tester in seconds: the default, or more if the PIXIT requires it."""
    return max(UPPER_PATIENCE, pics.pixit.least_patience_ms / 1000)


def _foreign(options: TargetOptions, codec: Codec, pics: Pics, stack: contextlib.ExitStack) -> _Opened:
    from dcp_conformance.sut.process import ProcessControl

    control: SutControl | None = None
    process: ProcessControl | None = None
    if any((options.start, options.stop, options.restart, options.pid)):
        process = ProcessControl(
            start=options.start,
            stop=options.stop,
            restart=options.restart,
            pid=options.pid,
            log=options.output if options.start else None,
            udp_port=None if options.interface is not None else _udp_port(options, codec),
        )
        control = process
        stack.callback(process.close)
    lower = open_lower(options, codec)
    stack.callback(lower.close)
    if process is not None:
        other = _node_on_link(_session(options, codec, pics, lower, None)) if options.start else ""
        process.start()
        if other and process.alive():
            raise UsageError(
                f"--start: {other} has answered on {lower.name} before it was started: end the node that runs there, "
                "leave out --start, or name the implementation (pixit.node_id) if other nodes must be on the link"
            )
    upper = None
    if options.ut is not None:
        from dcp_conformance.upper_tester.stream import StreamUpperTester

        upper = _open_upper(options, options.ut, pics, process)
        if process is not None:
            process.after_restart.append(
                partial(_connected, process, options.start_timeout or START_PATIENCE, upper.reconnect)
            )
            if isinstance(upper, StreamUpperTester):
                upper.gone = lambda: process.alive() is False
    return _session(options, codec, pics, lower, upper), control, []


def _open_upper(options: TargetOptions, spec: str, pics: Pics, process: ProcessControl | None) -> Reconnecting:
    """Open the upper tester; an implementation that the tester has started gets the time that a start may take."""
    from dcp_conformance.upper_tester.opening import open_upper

    if process is None:
        return open_upper(spec, _patience(pics), starting=False)
    seconds = (options.start_timeout or START_PATIENCE) if options.start else 0.0
    return _connected(process, seconds, lambda: open_upper(spec, _patience(pics), starting=True))


_Connected = TypeVar("_Connected")


def _connected(process: SutControl, seconds: float, connect: Callable[[], _Connected]) -> _Connected:
    """Connect to the upper tester of an implementation that may have been started just now; raise ``ConformanceError``.

    ``seconds``: maximum duration of a start, which may be longer than the timeout of an answer.
    """
    deadline = time.monotonic() + seconds
    while True:
        try:
            return connect()
        except UpperTesterError as error:
            if process.alive() is False:
                # The upper tester cannot be reached because the process is dead: report that instead.
                raise ConformanceError(f"--start: {process.why_dead()}") from error
            if not isinstance(error, NoListenerError) or time.monotonic() >= deadline:
                raise


def _node_on_link(session: Session) -> str:
    """Return the identifier of a node that answers before the implementation is started; empty if none answers.

    A second instance of the implementation would use the same identifier, and its faults could not be distinguished.
    """

    from dcp_conformance.suite import sanity

    if session.pics.pixit.node_id is not None:
        session.sut_id = node_id_octets(session.pics.pixit.node_id)
    bench = Bench(session, next(cases_of(sanity)))
    # A busy machine delays an answer by much more than a beacon period.
    periods = max(5, _ANSWER_NS / bench.period)
    there = bench.beacons(1, periods) if bench.sut.pics.vardis is False else bench.probes.probe(periods)
    return session.sut_id.hex(":") if there and session.sut_id is not None else ""


def say_contradictions(runner: Runner, say: Callable[[str], None]) -> None:
    """Call ``say`` with each claim of PICS and PIXIT that beacons or the upper tester contradict."""
    from dcp_conformance.suite import sanity

    for text in runner.contradicted_claims(next(cases_of(sanity))):
        say(text)


def require_answer(runner: Runner, say: Callable[[str], None]) -> None:
    """Determine the identifier of the implementation from its beacons, after waiting for a start.

    ``say`` is called with a message for the user if the start takes long.
    Raise :class:`ConformanceError` if neither a beacon nor an answer to a stimulus arrives.
    """
    from dcp_conformance.suite import sanity

    session, case = runner.session, next(cases_of(sanity))
    why = runner.life.await_start(case, say) if runner.control is not None else ""
    say_contradictions(runner, say)
    bench = Bench(session, case)
    if not bench.beacons(1, 5) and not bench.probes.probe(10) and not bench.heard:
        why = why or "neither its beacons nor reactions arrive there"
        raise ConformanceError(f"no implementation answers on {session.lower.name}: {why}")


def _udp_port(options: TargetOptions, codec: Codec) -> int:
    """Return the UDP port of the link. Raise :class:`UsageError` for an invalid ``--link``."""
    from dcp_conformance.lower_tester.udp import DEFAULT_PORT, parse_udp

    _, port, _, link = parse_udp(options.link or "udp", codec.profile.link)
    return port if port is not None else link.udp_port or DEFAULT_PORT


def open_lower(options: TargetOptions, codec: Codec) -> LowerTester:
    """Open the lower tester for an implementation that is not the reference node.

    Raise :class:`UsageError` for options that contradict each other or the profile, and ``LowerTesterError`` if the
    link cannot be opened.
    """
    if options.interface is not None and options.link is not None:
        raise UsageError("--interface and --link both name the link; give one of them")
    if options.interface is not None:
        if codec.profile.link.transport == "udp":
            raise UsageError(f"the profile {codec.profile.name} uses UDP: give --link udp instead of --interface")
        from dcp_conformance.lower_tester.ethernet import open_ethernet

        return open_ethernet(options.interface, codec.profile.link)
    from dcp_conformance.lower_tester.udp import open_udp, parse_udp

    return open_udp(*parse_udp(options.link or "udp", codec.profile.link))
