"""dcp-vardis.md: Extraction Step, payloads with errors.

From 1.2 on, the reaction is up to the implementation (X34): the cases report it and require survival.
"""

from __future__ import annotations

import itertools
import random
from collections.abc import Callable

from dcp_spec.constants import BP_PROTID_VARDIS, ICType

from dcp_conformance.definitions.case import Variant, case
from dcp_conformance.frames.builder import Block
from dcp_conformance.test_steps.services import teach_variable
from dcp_conformance.test_steps.variable_queries import ask, check_state, own_id
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

_Bad = Callable[[Bench, Peer, int], bytes]


def _of_type(number: int) -> _Bad:
    return lambda bench, peer, var_id: bench.builder.container(peer.summary(var_id, 1), ic_type=number)


def _with_count(kind: Callable[[Peer, int], object], count: int) -> _Bad:
    """Return a builder of a container with two records and a wrong number of records in its header."""

    def build(bench: Bench, peer: Peer, var_id: int) -> bytes:
        records = (kind(peer, var_id), kind(peer, var_id))
        return bench.builder.container(*records, count=count)  # type: ignore[arg-type]

    return build


def _empty(number: int) -> _Bad:
    return lambda bench, peer, var_id: bench.builder.empty_container(number)  # noqa: ARG005


def _long_value(bench: Bench, peer: Peer, var_id: int) -> bytes:
    return bench.builder.container(peer.update(var_id, 1, b"v"), lies={"records[0].value.length": 255})


def _long_value_in_create(bench: Bench, peer: Peer, var_id: int) -> bytes:
    return bench.builder.container(peer.create(var_id), lies={"records[0].upd.value.length": 255})


def _long_description(bench: Bench, peer: Peer, var_id: int) -> bytes:
    record = peer.create(var_id)
    if bench.features.string_format == "nul-terminated":
        # Without its NUL the description has no end.
        octets = bench.builder.container(record)
        return octets.replace(record.spec.descr + b"\0", record.spec.descr + b"\x01")
    return bench.builder.container(record, lies={"records[0].spec.descr.length": 255})


def _summary(peer: Peer, var_id: int) -> object:
    return peer.summary(var_id, 1)


def _update(peer: Peer, var_id: int) -> object:
    return peer.update(var_id, 1, b"value")


_BAD: dict[str, tuple[str, _Bad]] = {
    "type-0": ("VD-RX-05", _of_type(0)),
    "type-7": ("VD-RX-05", _of_type(7)),
    "type-255": ("VD-RX-05", _of_type(255)),
    "count-0": ("VD-RX-06", _empty(ICType.SUMMARIES)),
    "count-0-creates": ("VD-RX-06", _empty(ICType.CREATE_VARIABLES)),
    "count-0-with-record": ("VD-RX-06", _with_count(_summary, 0)),
    "count+1": ("VD-RX-07", _with_count(_summary, 3)),
    "count-1": ("VD-RX-07", _with_count(_summary, 1)),
    "count-255": ("VD-RX-07", _with_count(_summary, 255)),
    "updates-count+1": ("VD-RX-07", _with_count(_update, 3)),
    "updates-count-1": ("VD-RX-07", _with_count(_update, 1)),
    "updates-count-255": ("VD-RX-07", _with_count(_update, 255)),
    "value-too-long": ("VD-RX-07", _long_value),
    "created-value-too-long": ("VD-RX-07", _long_value_in_create),
    "description-too-long": ("VD-RX-07", _long_description),
    "header-only": ("VD-RX-07", lambda bench, peer, var_id: bench.builder.empty_container(1, 1)),  # noqa: ARG005
}

#: Errors that turn octets of other containers into records: records about these do not show a policy.
_UNCLEAR = {name for name in _BAD if "count" in name and name not in ("count-0", "count-0-creates")} | {"header-only"}


@case(
    "TC_VD_ROB_BI_01",
    "A receiver survives a container with an error at any position in a payload ({variant})",
    requirements="VD-ROB-01",
    family="malformed containers",
    stimulus="payloads with this container alone, before, after and between valid ones; then a probe",
    expect="VarDis continues; the case reports which valid containers are processed",
    window=8,
    variants={
        name: Variant((bad, name), requirements=f"{requirement} VD-ROB-01") for name, (requirement, bad) in _BAD.items()
    },
    destructive=True,
    robustness=True,
)
def bad_container(bench: Bench, what: tuple[_Bad, str]) -> None:
    bad, name = what
    peer = bench.peer()
    before, behind, first, last, *damaged = bench.identifiers.unknown_ids(8)
    bench.identifiers.created.update(damaged)

    def good(var_id: int) -> bytes:
        return bench.builder.container(peer.summary(var_id, 1))

    since = peer.stimulate(bad(bench, peer, damaged[0]))
    peer.send(good(before), bad(bench, peer, damaged[1]))
    peer.send(bad(bench, peer, damaged[2]), good(behind))
    peer.send(good(first), bad(bench, peer, damaged[3]), good(last))
    bench.require_alive("a payload with this error", "VD-ROB-01")
    # Right after a start the first of these may have come before the implementation could receive it.
    peer.send(bad(bench, peer, damaged[0]))
    bench.beacons(1, 1.5)

    def processed(var_id: int) -> bool:
        return bool(bench.instructions(ICType.REQUEST_VARCREATES, var_id, since))

    seen = {
        "the container before the error": processed(before),
        "the container after the error": processed(behind),
        "the first of three": processed(first),
        "the last of three": processed(last),
    }
    kept = ", ".join(where for where, done in seen.items() if done) or "nothing"
    requirement = bench.case.requirements[0]
    bench.info("Which containers of a payload with this error are processed?", kept, requirement)
    policy = {(True, False): "keep-prefix", (False, False): "drop-payload", (True, True): "skip-container"}.get(
        (processed(first), processed(last))
    )
    consistent = processed(before) == processed(first) and processed(behind) == processed(last)
    if policy is not None and consistent and name not in _UNCLEAR:
        # A container can only be skipped where its end can be found, for certain where it has no records.
        alike = ("skip-container",) if policy == "keep-prefix" and not name.startswith("count-0") else ()
        bench.reading("X34", policy, *alike)
    _works(bench)


def _works(bench: Bench) -> None:
    """Check that VarDis works: teach it a variable, an update and a deletion."""
    # Must not be a variable that a damaged record may have created with another creationTime.
    peer, var_id = bench.peer(), bench.unknown_id()
    bench.identifiers.created.add(var_id)
    for record, kind in (
        (peer.create(var_id), ICType.CREATE_VARIABLES),
        (peer.update(var_id, 1), ICType.UPDATES),
        (peer.delete(var_id), ICType.DELETE_VARIABLES),
    ):
        came = None
        for _ in range(2):
            peer.send(record)
            came = bench.until_instruction(kind, var_id)
            if came is not None:
                break
        bench.equal(
            came, record, f"the {kind.label} record after the error, forwarded unchanged", "VD-ROB-01", stop=True
        )


@case(
    "TC_VD_ROB_BI_02",
    "A receiver survives a payload truncated after any octet",
    requirements="VD-RX-07 VD-ROB-01",
    family="malformed containers",
    stimulus="a payload with containers of all six types, truncated after each of its octets; then a probe",
    expect="VarDis continues, and a variable with missing octets is not stored",
    window=12,
    destructive=True,
    robustness=True,
)
def cut_off(bench: Bench) -> None:
    peer = bench.peer()
    first, created, *others = bench.identifiers.unknown_ids(6)
    bench.identifiers.created.add(created)
    containers = [
        bench.builder.container(peer.summary(first, 1)),
        bench.builder.container(peer.request_update(others[0], 1)),
        bench.builder.container(peer.request_create(others[1])),
        bench.builder.container(peer.delete(others[2])),
        bench.builder.container(peer.update(others[3], 1, b"value")),
        bench.builder.container(peer.create(created, value=b"value", descr=b"cut")),
    ]
    whole = b"".join(containers)
    # Truncated between two containers, the payload is valid.
    good = set(itertools.accumulate(map(len, containers)))
    since = bench.mark()
    for size in range(1, len(whole)):
        if size in good:
            continue
        peer.send(Block(BP_PROTID_VARDIS, whole[:size]))
        if size % 16 == 0:
            bench.until(bool, 1.5)
    bench.require_processed("truncated payloads", "VD-ROB-01")
    kept = bool(bench.instructions(ICType.REQUEST_VARCREATES, first, since))
    bench.info(
        "Which containers of a truncated payload are processed?",
        "the containers before the error" if kept else "nothing",
        "VD-RX-07",
    )
    # Nothing follows the truncated container: skipping it looks like keeping what precedes it.
    if kept:
        bench.reading("X34", "keep-prefix", "skip-container")
    else:
        bench.reading("X34", "drop-payload")
    check_state(bench, ask(bench, created), "unknown", "state of a variable with missing octets", "VD-ROB-01")
    _works(bench)


def _mutated(rng: random.Random, octets: bytes) -> bytes:
    """Return the octets with a few random changes of values, lengths and order."""
    found = bytearray(octets)
    for _ in range(rng.randint(1, 4)):
        place = rng.randrange(len(found)) if found else 0
        match rng.randrange(6):
            case 0 if found:
                found[place] ^= 1 << rng.randrange(8)
            case 1 if found:
                found[place] = rng.choice((0, 1, 0x7F, 0x80, 0xFE, 0xFF))
            case 2:
                del found[place : place + rng.randint(1, 6)]
            case 3:
                found[place:place] = rng.randbytes(rng.randint(1, 6))
            case 4:
                found[place:place] = found[: rng.randint(1, 12)]
            case _:
                found += rng.randbytes(rng.randint(1, 12))
    return bytes(found) or b"\0"


@case(
    "TC_VD_ROB_BI_03",
    "A receiver survives payloads with random errors (seed {variant})",
    requirements="VD-ROB-01",
    alone="it sends records with random identifiers",
    stimulus=(
        "160 payloads of all kinds of containers with octets changed, removed, repeated and added; then a "
        "functional check"
    ),
    expect="VarDis continues: a new variable is learnt, updated and deleted",
    window=20,
    variants={str(seed): seed for seed in (1, 2)},
    destructive=True,
    robustness=True,
)
def random_errors(bench: Bench, seed: int) -> None:
    # The payloads depend only on the seed of the session and the variant.
    rng = random.Random(f"{bench.session.seed}/{seed}")  # noqa: S311 - no secret
    peer, known = bench.peer(), teach_variable(bench, bench.peer())
    own_id(bench)
    unknown = bench.identifiers.unknown_ids(2)
    for count in range(160):
        var_id = rng.choice((known, *unknown))
        records = [
            bench.builder.container(peer.summary(var_id, rng.randrange(256))),
            bench.builder.container(*(peer.update(each, 1, rng.randbytes(rng.randint(1, 20))) for each in unknown)),
            bench.builder.container(peer.request_update(var_id, rng.randrange(256))),
            bench.builder.container(peer.request_create(var_id)),
            bench.builder.container(peer.create(var_id, value=rng.randbytes(5), rep_cnt=1)),
            bench.builder.container(peer.delete(unknown[0])),
        ]
        payload = b"".join(rng.sample(records, rng.randint(1, 4)))
        peer.send(Block(BP_PROTID_VARDIS, _mutated(rng, payload)))
        if count % 16 == 15:
            bench.until(bool, 1.5)
    _works(bench)
    bench.require_alive("payloads with random errors")
