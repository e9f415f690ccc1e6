"""Networks without a fault: ``check`` must not report a finding in their recordings."""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Sequence
from typing import Final

import msgspec
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.codec import Codec
from dcp_selftest.recordings.networks import NetworkSituation, Other, record
from dcp_selftest.runner import in_processes
from dcp_selftest.variants import all_variants
from dcp_selftest.variants.variant import Variant
from dcp_stack.config import NodeConfig

from .judging import found, judged

#: Profiles of the networks in rotation; the newest version is used twice as often.
PROFILES: Final = ("dcp-2.0", "dcp-2.0", "cpp-2.0", "dcp-1.3", "cpp-1.3", "dcp-1.2", "dcp-1.1", "dcp-1.0")
#: In each third network, a permitted variant replaces one node.
_VARIANTS: Final = 3


class FalseFinding(msgspec.Struct, frozen=True):
    """A false finding: one in a network without a fault."""

    situation: str
    rule: str
    requirements: tuple[str, ...]
    text: str


class CleanResult(msgspec.Struct, frozen=True, kw_only=True):
    """The outcome of all networks without a fault."""

    networks: int
    beacons: int
    false: tuple[FalseFinding, ...]
    doubts: int
    """Networks with at least one inconclusive verdict."""
    seconds: float
    """Processor time."""


def situation(number: int) -> NetworkSituation:
    """Return network ``number``: profile, topology, loss, restarts and clocks are derived from the number only."""
    rng = random.Random(f"clean/{number}")  # noqa: S311 - the draw must be repeatable
    return NetworkSituation(
        profile=PROFILES[number % len(PROFILES)],
        nodes=rng.choice([3, 5, 5, 7]),
        shape=rng.choice(["bus", "line", "grid", "moving"]),
        loss=rng.choice([0.0, 0.0, 0.1, 0.3, 0.5]),
        busy=rng.choice([0.5, 1.0, 3.0]),
        restarts=rng.random() < 0.3,
        late=rng.random() < 0.3,
        clocks=rng.random() < 0.3,
        recorder_loss=rng.choice([0.0, 0.0, 0.0, 0.05, 0.2]),
        recorder_clock=rng.random() < 0.15,
        seed=number,
    )


def variant_of(number: int, profile: str) -> Variant | None:
    """Return the permitted variant in network ``number``; None for networks without a variant."""
    if number % _VARIANTS:
        return None
    fitting = [each for each in all_variants().values() if each.applies_to(profile) and _is_node(each, profile)]
    return random.Random(f"variant/{number}").choice(fitting) if fitting else None  # noqa: S311


def _is_node(variant: Variant, profile: str) -> bool:
    """Return whether a variant changes the node only: not the application or the clock, and SRP is configured."""
    setup = variant.build(profile)
    return setup.application is None and setup.clock(0) == 0 and setup.config.srp is not None


def _task(number: int) -> tuple[int, list[FalseFinding], bool, float]:
    began = time.process_time()
    case = situation(number)
    variant = variant_of(number, case.profile)
    codec, others, text = Codec(case.profile), {}, str(case)
    if variant is not None:
        setup = variant.build(case.profile)
        codec = setup.config.codec
        width = len(setup.config.node_id)

        def configured(config: NodeConfig) -> NodeConfig:
            own = config.node_id if len(config.node_id) == width else setup.config.node_id
            return msgspec.structs.replace(setup.config, node_id=own, codec=config.codec)

        others = {case.nodes // 2: Other(setup.make, configured)}
        text += f", with {variant.id}"
    frames = record(case, others, codec=codec)
    cases = judged(frames, codec)
    false = [
        FalseFinding(text, rule, requirements, observed)
        for rule, findings in found(cases, Verdict.FAIL, Verdict.ERROR).items()
        for observed, requirements in findings.items()
    ]
    return len(frames), false, bool(found(cases, Verdict.INCONCLUSIVE)), time.process_time() - began


def clean(
    numbers: Sequence[int],
    *,
    jobs: int | None = None,
    on_result: Callable[[int, list[FalseFinding]], None] | None = None,
) -> CleanResult:
    """Judge the networks ``numbers`` in ``jobs`` processes (default: one for each processor).

    ``on_result`` is called with the number and the false findings of each network when it is complete.
    """
    beacons = doubts = 0
    seconds = 0.0
    false: dict[int, list[FalseFinding]] = {}
    for place, (count, findings, doubt, spent) in in_processes(_task, numbers, jobs):
        beacons, doubts, seconds = beacons + count, doubts + doubt, seconds + spent
        false[numbers[place]] = findings
        if on_result is not None:
            on_result(numbers[place], findings)
    every = tuple(each for number in sorted(false) for each in false[number])
    return CleanResult(networks=len(numbers), beacons=beacons, false=every, doubts=doubts, seconds=round(seconds, 1))
