"""Recordings for tests of what judges recordings: simulated networks, and beacons made by hand."""

from __future__ import annotations

import random
from collections.abc import Iterable, Sequence

from dcp_conformance.check import Judge
from dcp_conformance.pics import Pics
from dcp_conformance.results import CaseResult, RunResult
from dcp_conformance.verdict import Verdict
from dcp_spec.constants import features

from dcp_codec import Codec
from dcp_codec.capture import Frame
from dcp_stack.config import BPConfig, SRPConfig, VardisConfig
from dcp_stack.links.memory import PERFECT, Quality
from dcp_stack.links.topology import Full, Topology
from dcp_stack.sim.network import Network

from .rig import codec_of

MS = 1_000_000
SECOND = 1000 * MS


class Recorder:
    """Hears everybody, wherever they are: more than any node does."""

    def __init__(self, codec: Codec) -> None:
        self.frames: list[Frame] = []
        self._ether_type = (codec.profile.link.ether_type or 0x4953).to_bytes(2, "big")

    def saw(self, octets: bytes, wall: int, *, outgoing: bool, source: bytes) -> None:  # noqa: ARG002 - a Watcher
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


def judged(frames: Iterable[Frame], profile: str, pics: Pics | None = None) -> RunResult:
    """What the invariants say of a recording."""
    judge = Judge(codec_of(profile), pics or Pics(), recording="test.mcap", command="again")
    for frame in frames:
        judge.feed(frame)
    return judge.result()


def findings(run: RunResult) -> list[str]:
    """What did not hold, in lines."""
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
