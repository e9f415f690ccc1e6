"""dcp-bp.md: Configurable Parameters."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.suite.bp.beacons.timing import estimate, overload
from dcp_conformance.test_steps.bp_clients import (
    CLIENT,
    DEREGISTER,
    ILLEGAL_SIZE,
    ONCE,
    REGISTER,
    REPEAT,
    BPClient,
    areas_of_fixed_size,
    block_header_octets,
    header_octets,
    needed,
    some_beacons,
    talking,
)
from dcp_conformance.test_steps.services import parameters_set
from dcp_conformance.test_system.bench import MS, Bench

V1_0, V1_1, V2_0 = SpecVersion.V1_0, SpecVersion.V1_1, SpecVersion.V2_0
GET, SET = "BP-GetParameters", "BP-SetParameter"
PERIOD, SIZE, NETWORK = "BPPAR_BEACON_PERIOD", "BPPAR_MAXIMUM_PACKET_SIZE", "BPPAR_NETWORK_ID"
UWB_SIZE = "UWB-MaxPacketSize"

_PARAMETERS = Needs(since=V1_1, entities=(), ut=(GET, SET))


def values(bench: Bench) -> dict[str, Any]:
    """Return the parameters in the answer to BP-GetParameters, by name; fails and stops the case without them."""
    answer = bench.call(GET)
    bench.services.require_asked(answer, f"an answer to {GET}")
    bench.required(answer.ok, f"a positive answer to {GET}", "BP-PAR-01", seen=answer)
    found = answer.result.get("parameters")
    names = found if isinstance(found, dict) else None
    return bench.present(names, f"parameters in the answer to {GET}", "BP-PAR-01", seen=f"parameters: {found!r}")


def changed(bench: Bench, name: str) -> int:
    """Return a valid value for a parameter that differs from the current one."""
    old = bench.sut.parameter(name)
    return {PERIOD: 2 * old, SIZE: old - 7, NETWORK: old ^ 0x0102}[name]


_EACH = {
    "period": Variant(PERIOD, requirements="BP-PAR-01 BP-PAR-03"),
    "packet-size": Variant(SIZE, requirements="BP-PAR-01 BP-PAR-04"),
    "network": Variant(
        NETWORK,
        requirements="BP-PAR-01 BP-PAR-05",
        needs=Needs(since=V2_0, entities=(), ut=(GET, SET), header=("networkId",)),
    ),
}


@case(
    "TC_BP_PAR_BV_01",
    "A parameter can be read and set ({variant})",
    requirements="BP-PAR-01",
    stimulus="BP-SetParameter with another valid value ({variant}), BP-GetParameters before and after",
    expect="the value that was set; the other parameters as before",
    needs=_PARAMETERS,
    variants=_EACH,
)
def set_and_get(bench: Bench, name: str) -> None:
    before = values(bench)
    bench.proved(name in before, f"{name} in the answer to {GET}", f"only {', '.join(before)}", "BP-PAR-01", stop=True)
    new = changed(bench, name)
    answer = bench.call(SET, name=name, value=new)
    try:
        bench.proved(answer.ok, f"a positive answer when {name} is set to {new}", answer)
        after = values(bench)
    finally:
        bench.call(SET, name=name, value=before[name])
    observed = after.get(name)
    # The resolution of times is up to the implementation.
    near = name == PERIOD and isinstance(observed, int | float) and abs(observed - new) < abs(before[name] - new) / 2
    bench.proved(observed == new or near, f"{name} is {new}", observed)
    # The answer may also have other fields, which may depend on the changed parameter.
    others = [
        each for each in (PERIOD, SIZE, NETWORK, UWB_SIZE) if each != name and after.get(each) != before.get(each)
    ]
    bench.none(others, "the other parameters as before")


_WRONG: dict[str, tuple[str, Callable[[Bench], int]]] = {
    "period-0": (PERIOD, lambda _: 0),
    "period-negative": (PERIOD, lambda _: -100),
    "size-0": (SIZE, lambda _: 0),
    "size-below-headers": (SIZE, lambda bench: header_octets(bench) + block_header_octets(bench) - 1),
    "size-above-bearer": (SIZE, lambda bench: int(values(bench).get(UWB_SIZE, 0xFFFF)) + 1),
    "network-too-large": (NETWORK, lambda bench: 1 << (8 * bench.profile.types.network_id.width)),
    "network-negative": (NETWORK, lambda _: -1),
}
_RULES = {PERIOD: "BP-PAR-03", SIZE: "BP-PAR-04 BP-PAR-13", NETWORK: "BP-PAR-05"}


@case(
    "TC_BP_PAR_BI_01",
    "An invalid value is rejected and the old one kept ({variant})",
    requirements="BP-PAR-06",
    stimulus="BP-SetParameter with an invalid value ({variant}) while a client repeats a payload",
    expect=(
        "BP-GetParameters returns the old value; beacons continue; the case reports whether the confirm shows the "
        "rejection"
    ),
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, GET, SET)),
    variants={
        name: Variant(
            wrong,
            requirements=f"BP-PAR-06 {_RULES[wrong[0]]}",
            needs=Needs(
                since=V2_0 if wrong[0] == NETWORK else V1_0 if name == "size-above-bearer" else V1_1,
                entities=(),
                ut=(*CLIENT, GET, SET),
                header=("networkId",) if wrong[0] == NETWORK else (),
            ),
        )
        for name, wrong in _WRONG.items()
    },
    window=6,
)
def invalid_values(bench: Bench, wrong: tuple[str, Callable[[Bench], int]]) -> None:
    name, value_of = wrong
    with BPClient(bench, REPEAT) as client:
        client.transmit(client.payload())
        first, value = values(bench), value_of(bench)
        # Set to a value other than the default first: the implementation must keep the old value, not restore the
        # default.
        bench.must(SET, name=name, value=changed(bench, name))
        before = values(bench)
        try:
            answer = bench.call(SET, name=name, value=value)
            after = values(bench)
        finally:
            bench.call(SET, name=name, value=first[name])
        bench.answered(after.get(name), before.get(name), f"{name}, as before")
        frames = [bench.until(client.in_frame) for _ in range(2)]
        bench.some(all(frames), "beacons continue", "BP-PAR-06")
        bench.info(
            "Does the confirm report the rejection of a parameter value?",
            "no" if answer.ok else str(answer),
            "BP-PAR-07",
        )


@case(
    "TC_BP_PAR_BI_03",
    "After an invalid value was rejected, the old one stays in effect ({variant})",
    requirements="BP-PAR-06 BP-PAR-02",
    stimulus="BP-SetParameter with another valid value ({variant}), then with invalid ones, while a client sends",
    expect="beacons and registrations according to the valid value, not to the default or an invalid one",
    needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, GET, SET)),
    variants={
        "period": (PERIOD, (0, -100)),
        "packet-size": Variant(
            (SIZE, (0, 1)), needs=Needs(since=V1_1, entities=(), ut=(*CLIENT, GET, SET), when=areas_of_fixed_size)
        ),
        "network": Variant(
            (NETWORK, (-1,)), needs=Needs(since=V2_0, entities=(), ut=(*CLIENT, GET, SET), header=("networkId",))
        ),
    },
    window=30,
)
def still_in_effect(bench: Bench, wrong: tuple[str, tuple[int, ...]]) -> None:
    name, refused = wrong
    usual, new = bench.period, changed(bench, name)
    with talking(bench), parameters_set(bench, "BP", **{name: new}):
        for value in refused:
            if bench.call(SET, name=name, value=value).ok and values(bench).get(name) == value:
                bench.inconclusive(f"{name} = {value} is rejected, which this case needs", "accepted")
        if name == SIZE:
            counted = header_octets(bench) if bench.features.registration_counts_bp_header else 4
            third = BPClient(bench, ONCE, size=new - counted - block_header_octets(bench) + 1)
            if bench.expect_status(ILLEGAL_SIZE, REGISTER, **third.registration).ok:
                bench.call(DEREGISTER, protId=third.prot_id)
            return
        bench.wait(0.5)
        frames = some_beacons(bench, 9 if name == PERIOD else 3)
        if name == PERIOD:
            found = estimate(frames)
            bench.proved(
                found.mean + found.margin > 1.5 * usual, f"a mean interval of about {new} ms", found, frames=frames[:4]
            )
            if found.mean - found.margin > 1.5 * new * MS and not overload(bench):
                bench.some(None, f"a mean interval of about {new} ms", seen=found)
        else:
            numbers = {each.beacon.bp.network_id for each in frames if each.beacon and each.beacon.bp}
            bench.only(numbers, {new}, f"beacons of network {new:#x}", frames=frames[:4])


@case(
    "TC_BP_PAR_BV_02",
    "BPPAR_MAXIMUM_PACKET_SIZE may have any value from the size of both headers to the bearer's maximum",
    requirements="BP-PAR-04 BP-PAR-14",
    stimulus="BP-SetParameter with the largest value, and with the size of both headers",
    expect="both accepted; the smallest may be rejected because no payload fits (X05)",
    needs=_PARAMETERS,
)
def size_bounds(bench: Bench) -> None:
    known = values(bench)
    if UWB_SIZE in known:
        answer = bench.call(SET, name=SIZE, value=known[UWB_SIZE])
        bench.proved(answer.ok, f"{SIZE} can be set to {UWB_SIZE}, {known[UWB_SIZE]}", answer, "BP-PAR-04")
        if known.get(SIZE) == known[UWB_SIZE]:
            bench.passed(f"the bearer's maximum as initial value of {SIZE}", "BP-PAR-14")
        else:
            bench.info(
                f"Is the initial value of {SIZE} the bearer's maximum?", f"no, it is {known.get(SIZE)}", "BP-PAR-14"
            )
    least = header_octets(bench) + block_header_octets(bench)
    answer = bench.call(SET, name=SIZE, value=least)
    if answer.ok:
        bench.reading("X05", "literal-minimum")
    else:
        answer = bench.call(SET, name=SIZE, value=least + 1)
        if bench.proved(answer.ok, f"{SIZE} can be set to {least} or {least + 1}", answer, "BP-PAR-04"):
            bench.reading("X05", "usable-minimum")
    bench.call(SET, name=SIZE, value=known.get(SIZE))


@case(
    "TC_BP_PAR_BV_03",
    "A new BPPAR_MAXIMUM_PACKET_SIZE applies to the next beacon and registration",
    requirements="BP-PAR-02 BP-PAR-11",
    stimulus="two clients repeat payloads; the size is reduced so that only one of them fits into a beacon",
    expect="no larger beacon from then on; the new size limits registrations",
    needs=Needs(entities=(), ut=(*CLIENT, SET), when=areas_of_fixed_size),
    window=8,
)
def smaller_beacons(bench: Bench) -> None:
    with BPClient(bench, REPEAT, size=60) as one, BPClient(bench, REPEAT, size=60) as two:
        for client in (one, two):
            client.transmit(client.payload(60))
        needed(bench, bench.until(one.in_frame), "beacons before the change")
        size = header_octets(bench) + 60 + block_header_octets(bench) + 20
        with parameters_set(bench, "BP", **{SIZE: size}):
            from_now = bench.now() + bench.period // 5
            heard = [each for each in bench.beacons(4) if each.time >= from_now]
            large = [each for each in heard if len(each.octets) > size]
            if large and max(len(each.octets) for each in large) <= size + header_octets(bench):
                bench.reading("X04", "blocks-only")
                large = []
            bench.required(heard, "beacons after the change", "BP-PAR-02")
            observed = f"{len(large)} of {len(heard)} beacons are larger"
            bench.none(large, f"beacons of at most {size} octets", "BP-PAR-02", seen=observed)
            # In 1.0, the limit assumes another header size.
            counted = header_octets(bench) if bench.features.registration_counts_bp_header else 4
            third = BPClient(bench, ONCE, size=size - counted - block_header_octets(bench) + 1)
            answer = bench.expect_status(ILLEGAL_SIZE, REGISTER, "BP-PAR-11", **third.registration)
            if answer.ok:
                bench.call(DEREGISTER, protId=third.prot_id)


@case(
    "TC_BP_PAR_BV_04",
    "A new BPPAR_NETWORK_ID applies to the next beacon and to reception",
    requirements="BP-PAR-05 BP-PAR-02 BP-HDR-04 BP-HDR-05 BP-RX-05",
    stimulus="BPPAR_NETWORK_ID is set to a value with two different octets; beacons of the old and of the new network",
    expect="beacons with the new networkId; the beacon of the old network is dropped, that of the new one is processed",
    needs=Needs(since=V2_0, ut=(GET, SET), header=("networkId",)),
    window=8,
)
def other_network(bench: Bench) -> None:
    old = bench.sut.parameter(NETWORK)
    new = 0xA55B if old != 0xA55B else 0x5AA4
    with talking(bench):
        bench.until(lambda heard: heard.beacon)
        with parameters_set(bench, "BP", **{NETWORK: new}):
            from_now, peer = bench.now() + bench.period // 5, bench.peer()
            stranger, friend = bench.identifiers.unknown_ids(2)
            peer.send(peer.summary(stranger, 1), network_id=old)
            peer.send(peer.summary(friend, 1), network_id=new)
            # The tester's client may fill every other beacon: the number of blocks in a beacon is free.
            asked = bench.until_instruction(ICType.REQUEST_VARCREATES, friend, 2 * bench.sut.reaction)
            bench.some(asked, "a beacon of the new network is processed", "BP-PAR-05 BP-RX-05")
            heard = [each for each in (*bench.heard, *bench.beacons(3)) if each.time >= from_now]
            numbers = {
                each.beacon.bp.network_id
                for each in heard
                if each.beacon is not None and each.beacon.bp is not None and each.salvaged.clear
            }
            observed = f"beacons of networks {', '.join(f'{number or 0:#x}' for number in numbers)}"
            bench.only(numbers, {new}, f"beacons of network {new:#x}", "BP-HDR-04 BP-HDR-05 BP-PAR-02", seen=observed)
            found = bench.instructions(ICType.REQUEST_VARCREATES, stranger)
            bench.none(found, "a beacon of the old network is dropped", "BP-RX-05 BP-PAR-05")


@case(
    "TC_BP_PAR_BV_05",
    "The beacon period is about 100 ms by default",
    requirements="BP-PAR-15",
    stimulus="BP-GetParameters after a reset; without it, payloads to send in every period",
    expect="80 ms to 120 ms; a configured period, given in the PIXIT, is reported",
    window=16,
    needs=Needs(since=V1_1, entities=()),
)
def default_period(bench: Bench) -> None:
    configured = bench.sut.pixit.beacon_period_ms
    if bench.services.offers(GET):
        period = values(bench).get(PERIOD)
        near = isinstance(period, int | float) and 80 <= period <= 120
        if not near and period == configured:
            bench.info(f"Is the default {PERIOD} about 100 ms?", f"unknown: it was configured to {period} ms")
        else:
            bench.proved(near, f"{PERIOD} of about 100 ms", f"{period} ms")
        return
    with talking(bench):
        found = estimate(some_beacons(bench, 12))
    mean = found.mean / MS
    if not 80 <= mean <= 120 and abs(mean - configured) <= configured / 5:
        bench.info(
            f"Is the default {PERIOD} about 100 ms?", f"unknown: it was configured to {configured:g} ms: {found}"
        )
    else:
        bench.some(80 <= mean <= 120, "a mean interval of about 100 ms", seen=found)


@case(
    "TC_BP_PAR_BI_02",
    "Values determined at the start cannot be set",
    requirements="BP-PAR-08 BP-PAR-09",
    stimulus="BP-SetParameter for UWB-MaxPacketSize and ownNodeIdentifier, if BP-GetParameters returns them",
    expect="BP-GetParameters returns the same values as before",
    needs=_PARAMETERS,
)
def fixed_values(bench: Bench) -> None:
    before = values(bench)
    told = [name for name in (UWB_SIZE, "ownNodeIdentifier") if name in before]
    if not told:
        bench.info("Can values determined at the start be set?", f"unknown: {GET} returns none of them", "BP-PAR-08")
    for name in told:
        value = before[name]
        other: Any = value - 1 if isinstance(value, int) else "02:00:00:00:00:77"
        bench.call(SET, name=name, value=other)
        bench.answered(values(bench).get(name), value, f"{name}, as before", "BP-PAR-08 BP-PAR-09")
