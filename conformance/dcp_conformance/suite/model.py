"""Sequences of steps, judged by the model of the whole node."""

from __future__ import annotations

from collections import defaultdict

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.stateful.corpus import Sequence, corpus
from dcp_conformance.stateful.judged import judge
from dcp_conformance.test_system.bench import Bench

#: More places in queues, and more clients, than the sequences need.
_PLACES, _CLIENTS = 300, 8


def _limits(bench: Bench) -> str | None:
    """Return why the model cannot judge the implementation, or None; for ``Needs.when``."""
    if bench.profile.types.protocol_id.width < 2:
        return "the profile has too few identifiers of protocols"
    if any(each.block is not None for each in bench.profile.own_fields().get("VarSpec", ())):
        return "the model does not know the size of a VarSpec with added octets of varying number"
    return bench.sut.lacks("queue_entries", _PLACES) or bench.sut.lacks("clients", _CLIENTS) or None


def _variants() -> dict[str, Variant]:
    """Return a variant for each sequence."""
    counts: dict[str, int] = defaultdict(int)
    found: dict[str, Variant] = {}
    for each in corpus().sequences:
        counts[each.theme] += 1
        name = f"{each.theme}-{counts[each.theme]:02}"
        needs = Needs(ut=each.methods, entities=(), when=_limits)
        found[name] = Variant(each, requirements=" ".join(each.requirements), needs=needs, long=each.long)
    return found


@case(
    "TC_DCP_MODEL_BV_01",
    "No observation contradicts the model of a node: {variant}",
    requirements="BP-RX-16",
    stimulus="services, beacons of neighbours and waits, drawn at random (seed in data/model-sequences.json)",
    expect="every confirm, notification, beacon, table and database is one that the model allows",
    window=8,
    variants=_variants(),
)
def sequences(bench: Bench, sequence: Sequence) -> None:
    judge(bench, sequence.steps, alone=False)
