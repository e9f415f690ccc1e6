"""Recordings for tests of what judges recordings: simulated networks, and beacons made by hand."""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable, Iterable, Sequence

from dcp_conformance.check import Judge
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import CaseResult, RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_lab.sim.virtual.network import Network
from dcp_spec.constants import features

from dcp_codec import Codec
from dcp_codec.capture import Frame
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarDelete,
    VardisRecord,
    VarReqCreate,
    VarReqUpdate,
    VarSpec,
    VarSumm,
    VarUpdate,
)
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.virtual.quality import PERFECT, Quality
from dcp_stack.virtual.topology import Full, Topology

from .rig import codec_of

MS = 1_000_000
SECOND = 1000 * MS
#: The first number of a node in a script: it is older than the recording.
_FIRST = 1000


class Recorder:
    """Receives from all nodes, wherever they are: more than any node does."""

    def __init__(self, codec: Codec) -> None:
        self.frames: list[Frame] = []
        self._ether_type = (codec.profile.link.ether_type or 0x4953).to_bytes(2, "big")

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:
        """Note a transmission."""
        data = b"\xff" * 6 + source + self._ether_type + octets
        self.frames.append(Frame(len(self.frames) + 1, wall, data, len(data)))


def simulated(
    profile: str,
    count: int,
    *,
    seed: int = 1,
    seconds: float = 20.0,
    topology: Topology | None = None,
    quality: Quality = PERFECT,
    restarts: bool = False,
    busy: float = 1.0,
    bp: BPConfig | None = None,
) -> list[Frame]:
    """All beacons of a network in which applications create, update, delete and create again at random.

    ``busy``: service requests per node and second. ``restarts``: nodes are switched off and on in between.
    """
    codec = codec_of(profile)
    srp = SRPConfig() if codec.profile.srp.record else None
    network = Network(count, codec, seed=seed, topology=topology or Full(), quality=quality, bp=bp, srp=srp,
                      vardis=VardisConfig())  # fmt: skip
    recorder = Recorder(codec)
    network.watchers.append(recorder)
    rng = random.Random(f"traffic/{seed}")
    for index in range(count):
        network.at(rng.randrange(300) * MS, lambda index=index: network.start(index))
    for index in range(count):
        time = 0
        while True:
            time += round(rng.expovariate(busy) * SECOND)
            if time > (seconds - 3) * SECOND:
                break
            network.at(time, lambda index=index: _something(network, index, rng))
        if srp is not None:
            network.at(500 * MS, lambda index=index: _move(network, index, rng, seconds))
    if restarts:
        for number in range(3):
            time, index = round((4 + 4 * number) * SECOND), rng.randrange(count)
            network.at(time, lambda index=index: network.stop(index))
            network.at(time + rng.randrange(200, 2500) * MS, lambda index=index: network.start(index))
    network.run_until(round(seconds * SECOND))
    assert not any(station.failure for station in network.stations)
    return recorder.frames


def _move(network: Network, index: int, rng: random.Random, seconds: float) -> None:
    if network.stations[index].node is not None:
        layout = network.codec.profile.srp.safety_data
        data = {each.name: rng.randrange(100) for each in layout if hasattr(each, "type")}
        network.request(index, "SRP-UpdateSafetyData", sData=data)
    if network.now < (seconds - 1) * SECOND:
        network.at(network.now + 100 * MS, lambda: _move(network, index, rng, seconds))


def _something(network: Network, index: int, rng: random.Random) -> None:
    """A service request that may be refused."""
    if network.stations[index].node is None:
        return
    var_id, value = rng.randrange(12), rng.randbytes(rng.randrange(1, 20)).hex()
    action = rng.random()
    if action < 0.35:
        repetitions = rng.randrange(1, 4)
        timeout = rng.choice([0, 0, 0, 2500])
        network.request(index, "RTDB-Create", varId=var_id, repCnt=repetitions, descr=f"v{var_id}", value=value,
                        **({"timeout": timeout} if _has_timeout(network) else {}))  # fmt: skip
    elif action < 0.9:
        network.request(index, "RTDB-Update", varId=var_id, value=value)
    else:
        network.request(index, "RTDB-Delete", varId=var_id)


def _has_timeout(network: Network) -> bool:
    return features(network.codec.profile.spec_version).creation_time


def judged(frames: Iterable[Frame], profile: str, pics: Pics | None = None, *, enough: int | None = 1) -> RunResult:
    """Judge a recording by the invariants; without ``pics`` its beacon period is unknown.

    Recordings of tests are short: one occasion is ``enough`` for a pass, None for as many as users need.
    """
    judge = Judge(
        codec_of(profile),
        pics or Pics(),
        recording="test.mcap",
        command="again",
        period_known=pics is not None,
        enough=enough,
    )
    for frame in frames:
        judge.feed(frame)
    return judge.result()


def findings(run: RunResult) -> list[str]:
    """Violated invariants, one a line."""
    return [
        f"{case.id} {' '.join(check.requirements)}: {check.observed} at {[mark.frame for mark in check.frames]}"
        for case in run.cases
        for check in case.checks
        if check.verdict in (Verdict.FAIL, Verdict.ERROR)
    ]


def case_of(run: RunResult, identifier: str) -> CaseResult:
    """The result of one invariant."""
    return next(case for case in run.cases if case.id == identifier)


def thinned(frames: Sequence[Frame], share: float, seed: int) -> list[Frame]:
    """Without so many of the frames, drawn by chance: what a recorder has that loses some."""
    rng = random.Random(f"loss/{seed}")
    return [frame for frame in frames if rng.random() >= share]


KINDS = {
    VarCreate: "CREATE-VARIABLES",
    VarDelete: "DELETE-VARIABLES",
    VarReqCreate: "REQUEST-VARCREATES",
    VarSumm: "SUMMARIES",
    VarUpdate: "UPDATES",
    VarReqUpdate: "REQUEST-VARUPDATES",
}


class Script:
    """A recording made by hand: beacons of nodes 1, 2, 3, ... in turn, all well formed unless ``patch`` says otherwise.

    ``period`` is what passes between two beacons of one node when three take turns.
    """

    def __init__(self, profile: str = "dcp-2.0", period: int = 100 * MS) -> None:
        self.profile = profile
        self.codec = codec_of(profile)
        self.frames: list[Frame] = []
        self.time = 1_767_225_600 * SECOND
        self.step = period // 3
        self.seqno: dict[int, int] = {}
        self._reports: dict[int, int] = {}

    def node(self, number: int) -> bytes:
        """The identifier of a node."""
        return b"\x02\0\0\0\0" + bytes([number])

    def say(
        self,
        number: int,
        *records: VardisRecord,
        report: ExtendedSafetyData | None = None,
        network_id: int = 0x1111,
        seqno: int | None = None,
        destination: bytes = b"\xff" * 6,
        source: int | None = None,
        patch: Callable[[bytes], bytes] = bytes,
    ) -> int:
        """A beacon of a node, with containers in the order of ``records``; its frame number."""
        types = self.codec.profile.vardis.container_types.by_name()
        containers = tuple(
            Container(types[KINDS[kind]], tuple(group)) for kind, group in itertools.groupby(records, type)
        )
        payloads = ((Payload(1, report),) if report is not None else ()) + (
            (Payload(2, containers),) if containers else ()
        )
        this = self.seqno.get(number, _FIRST) if seqno is None else seqno
        self.seqno[number] = (this + 1) % 2**32
        has_network = self.codec.profile.has_header_field("networkId")
        header = BPHeader(self.node(number), this, network_id=network_id if has_network else None)
        octets = patch(self.codec.encode(Beacon(header, payloads)))
        data = destination + self.node(source or number) + b"\x49\x53" + octets
        self.time += self.step
        self.frames.append(Frame(len(self.frames) + 1, self.time, data, len(data)))
        return len(self.frames)

    def idle(self, rounds: int, *said: tuple[VardisRecord, ...], nodes: Sequence[int] = (1, 2, 3)) -> None:
        """Record ``rounds`` beacons of every node; ``said``: records of each node, by default summaries of nothing."""
        for _ in range(rounds):
            for place, number in enumerate(nodes):
                records = said[place] if place < len(said) else ()
                self.say(number, *(records or (VarSumm(200 + number, 0),)))

    def create(self, var_id: int, producer: int, *, seqno: int = 0, value: bytes = b"abcd", rep_cnt: int = 1,
               age: int = 0, descr: bytes = b"v") -> VarCreate:  # fmt: skip
        """A creation as the producer sends it; ``age`` in seconds."""
        has_time = features(self.codec.profile.spec_version).creation_time
        created = (1_767_225_600 - age) * SECOND if has_time else None
        spec = VarSpec(var_id, self.node(producer), rep_cnt, descr, created, 0 if has_time else None)
        return VarCreate(spec, VarUpdate(var_id, seqno, value))

    def report(self, number: int, *, about: int | None = None, seqno: int | None = None, late: int = 0,
               t_stamp: int | None = None) -> ExtendedSafetyData:  # fmt: skip
        """A state report of a node, made just now or ``late`` ns ago."""
        this = self._reports.get(number, 0) if seqno is None else seqno
        self._reports[number] = this + 1
        data = self.codec.safety_data_type(*([1.0] * len(self.codec.safety_data_type.__struct_fields__)))
        stamp = self.time - late if t_stamp is None else t_stamp
        return ExtendedSafetyData(data, self.node(about or number), stamp, this)
