"""dcp-vardis.md: Payload Format and Payload Construction Process.

One beacon with requests queues all instructions at once, so the time at which a payload is composed does not matter.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

from dcp_spec.constants import IC_MAX_RECORDS, ICType

from dcp_codec.values import VarCreate
from dcp_conformance.definitions.case import FILLS, Needs, case
from dcp_conformance.frames.received import ReceivedBeacon
from dcp_conformance.test_steps.full_payloads import PAYLOAD_SIZE, longest
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.sending.peers import Peer

#: Attempts to get one payload with all kinds of containers; in the second half each container is sent in a separate
#: beacon.
_ATTEMPTS = 6


#: Maximum number of variables used to fill a payload.
_MOST = 64


def stock(
    bench: Bench, peer: Peer, kind: ICType, *, mixed: bool = False, rep_cnt: int = 1, seqno: int = 0
) -> list[VarCreate]:
    """Teach the implementation variables whose records of a kind could fill more than two payloads.

    With ``mixed``, every third one is short.
    """
    bench.control.needs_whole_beacons()
    value, description = longest(bench)
    creates: list[VarCreate] = []
    octets = 0
    while octets < 2.2 * bench.sut.parameter(PAYLOAD_SIZE) and len(creates) < _MOST:
        short = mixed and len(creates) % 3 == 2
        create = peer.create(
            bench.var_id(),
            value=b"s" if short else value,
            descr=b"s" if short else description,
            rep_cnt=rep_cnt,
            seqno=seqno,
        )
        octets += bench.builder.record_size(create if kind is ICType.CREATE_VARIABLES else create.upd)
        creates.append(create)
    bench.learn(peer, *creates)
    return creates


def octets_up_to(bench: Bench, heard: ReceivedBeacon, kind: ICType) -> int:
    """Return the size in octets of a VarDis payload up to the end of its last container of a kind."""
    number = bench.builder.ic_type(kind)
    last = max((index for index, each in enumerate(heard.containers) if each.ic_type == number), default=-1)
    return len(bench.codec.encode_containers(heard.containers[: last + 1]))


def check_filled(bench: Bench, kind: ICType, frames: Sequence[ReceivedBeacon], *requirements: str) -> None:
    """Check that the next record would not have fitted into any of the payloads but the last."""
    limit = bench.sut.parameter(PAYLOAD_SIZE)
    if PAYLOAD_SIZE not in bench.session.parameters and bench.sut.pixit.max_payload_size is None:
        # The maximum size of a payload is unknown, but not less than the largest one.
        limit = max(octets_up_to(bench, heard, kind) for heard in frames)
    for heard, following in itertools.pairwise(frames):
        if len(heard.instructions(kind)) >= IC_MAX_RECORDS:
            continue
        used = octets_up_to(bench, heard, kind)
        size = bench.builder.record_size(following.instructions(kind)[0].record)
        bench.some(
            used + size > limit,
            f"a payload filled until the next {kind.label} record does not fit into {limit} octets",
            *requirements,
            seen=f"{limit - used} octets left, with a next record of {size}",
            frames=heard.instructions(kind)[-1:],
        )


def check_order_of_queue(bench: Bench, kind: ICType, var_ids: Sequence[int], since: int, *requirements: str) -> None:
    """Check that the records about these variables were sent in this order."""
    wanted = set(var_ids)
    found = [each for each in bench.instructions(kind, since=since) if each.var_id in wanted]
    came = [each.var_id for each in found]
    wrong = next((place for place, pair in enumerate(zip(came, var_ids, strict=False)) if pair[0] != pair[1]), None)
    what = f"{len(var_ids)} {kind.label} records in the order in which they were queued"
    bench.in_order(came, var_ids, what, *requirements, frames=found[wrong : wrong + 1] if wrong is not None else ())


def _room_for_all_kinds(bench: Bench) -> str | None:
    """Return why one payload cannot hold all six kinds of containers along with a full list of summaries; for
    ``Needs.when``.
    """
    summaries = bench.sut.bound("VARDISPAR_MAX_SUMMARIES")
    if not summaries:
        return "the implementation sends no summaries"
    create, size = bench.records.sample(), bench.builder.record_size
    octets = size(create) + size(create.upd) + (3 + min(summaries, 16)) * size(bench.records.summary(0, 0))
    octets += 6 * bench.builder.container_header_size
    limit = bench.sut.parameter(PAYLOAD_SIZE)
    return None if octets <= limit else f"{PAYLOAD_SIZE} is {limit}, and all kinds together may need {octets} octets"


@case(
    "TC_VD_PAY_BV_01",
    "The containers of a payload have the order of the specification, with all six kinds in one payload",
    requirements="VD-PAY-01 VD-PAY-07 VD-PAY-02 VD-IC-02",
    stimulus=(
        "one beacon that creates, deletes and updates a variable each, and summarises an unknown variable and a "
        "newer value"
    ),
    expect="one payload with all six kinds of containers, in the order of the version",
    needs=Needs(when=_room_for_all_kinds),
)
def order_of_containers(bench: Bench) -> None:
    peer = bench.peer()
    deleted, updated, outdated = bench.identifiers.var_ids(3)
    bench.learn(peer, *(peer.create(each, seqno=3) for each in (deleted, updated, outdated)))
    order = bench.features.container_order
    full: ReceivedBeacon | None = None
    # From here on there is always something to summarise, and much more room than this case needs.
    known = bench.mark()
    for attempt in range(_ATTEMPTS):
        created, unknown = bench.var_id(), bench.unknown_id()
        mark = bench.mark()
        records = (
            peer.create(created),
            peer.delete(deleted),
            peer.update(updated, 4 + attempt),
            peer.summary(outdated, 4 + attempt),
            peer.summary(unknown, 1),
        )
        if attempt < _ATTEMPTS // 2:
            peer.send(*records)
        else:
            # One container in each beacon, for implementations that process only one container of a payload.
            for record in records:
                peer.send(record)
        bench.until_instruction(ICType.REQUEST_VARCREATES, unknown)
        bench.beacons(1)
        full = next((each for each in bench.heard[mark:] if len({one.kind for one in each.instructions()}) == 6), None)
        if full is not None:
            break
        # A payload may have been composed while the beacon was being processed. Try again with new variables.
        bench.learn(peer, again := peer.create(bench.var_id()))
        deleted = again.spec.var_id
    for heard in bench.heard:
        kinds = [bench.builder.kind(each.ic_type) for each in heard.containers]
        places = [order.index(kind) for kind in kinds if kind is not None]
        bench.answered(
            places,
            sorted(places),
            "containers in the order " + ", ".join(each.label for each in order),
            "VD-PAY-01 VD-PAY-07",
            frames=[heard],
        )
    without = [each for each in bench.heard[known:] if each.instructions() and not each.instructions(ICType.SUMMARIES)]
    bench.none(without, "summaries along with every other container", "VD-PAY-01 VD-PAY-07")
    if full is None:
        bench.inconclusive("a payload with all six kinds of containers", f"none in {_ATTEMPTS} attempts", "VD-PAY-02")
    bench.passed("one payload with all six kinds of containers", "VD-PAY-02 VD-IC-02", frames=[full])
    if bench.verdicts.checks and all(each.verdict == "pass" for each in bench.verdicts.checks):
        kinds = [bench.builder.kind(each.ic_type) for each in full.containers]
        bench.reading("X18", ", ".join(kind.label for kind in kinds if kind is not None))


@case(
    "TC_VD_PAY_BV_02",
    "Payloads are filled until the next record does not fit, and never exceed their maximum ({variant})",
    requirements="VD-PAY-02 VD-IC-05",
    alone=FILLS,
    stimulus="requests for more variables, with the longest values, than fit into two payloads",
    expect="each payload but the last is full; none is larger than VARDISPAR_MAX_PAYLOAD_SIZE",
    window=12,
    variants={"creates": ICType.CREATE_VARIABLES, "updates": ICType.UPDATES},
)
def filled(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    creates = stock(bench, peer, kind, seqno=9)
    mark = request(bench, peer, kind, creates)
    frames = all_of(bench, kind, creates, mark)
    if len(frames) < 2:
        octets = sum(
            map(
                bench.builder.record_size,
                creates if kind is ICType.CREATE_VARIABLES else [each.upd for each in creates],
            )
        )
        if len(creates) == _MOST and octets < bench.sut.bound(PAYLOAD_SIZE):
            bench.verdicts.not_applicable(f"values are so short that {len(creates)} records have only {octets} octets")
        bench.inconclusive("more records than fit into a payload", f"{len(creates)} records in one payload")
    check_filled(bench, kind, frames, "VD-PAY-02")
    largest = max(frames, key=lambda heard: size_of(bench, heard))
    limit = bench.sut.bound(PAYLOAD_SIZE)
    text = f"{size_of(bench, largest)} octets"
    bench.proved(
        size_of(bench, largest) <= limit, f"payloads of at most {limit} octets", text, "VD-IC-05", frames=[largest]
    )


def size_of(bench: Bench, heard: ReceivedBeacon) -> int:
    return len(bench.codec.encode_containers(heard.containers))


def request(bench: Bench, peer: Peer, kind: ICType, creates: Sequence[VarCreate]) -> int:
    """Queue instructions about variables, all at once; return the mark before them."""
    mark = bench.mark()
    if kind is ICType.CREATE_VARIABLES:
        peer.send(*(peer.request_create(each.spec.var_id) for each in creates))
    elif kind is ICType.UPDATES:
        peer.send(*(peer.request_update(each.spec.var_id, each.upd.seqno - 1) for each in creates))
    else:
        peer.send(*(peer.delete(each.spec.var_id) for each in creates))
    return mark


def all_of(bench: Bench, kind: ICType, creates: Sequence[VarCreate], mark: int) -> list[ReceivedBeacon]:
    """Wait for records about all the variables; return the frames with them."""
    wanted = {each.spec.var_id for each in creates}
    frames = bench.until_quiet(lambda heard: wanted & {each.var_id for each in heard.instructions(kind)}, since=mark)
    came = {each.var_id for heard in frames for each in heard.instructions(kind)} & wanted
    what = f"{kind.label} records about all {len(wanted)} variables"
    bench.required(came == wanted, what, seen=f"only about {len(came)}", frames=frames[-1:])
    return frames


@case(
    "TC_VD_PAY_BV_03",
    "No container has two records of the same variable",
    requirements="VD-PAY-03",
    stimulus="three variables with several repetitions are created, updated, requested and deleted",
    expect="each container has at most one record of each variable",
    window=20,
)
def no_variable_twice(bench: Bench) -> None:
    peer, repetitions = bench.peer(), bench.sut.rep_cnt(3)
    var_ids = bench.identifiers.var_ids(3)
    bench.learn(peer, *(peer.create(each, seqno=1, rep_cnt=repetitions) for each in var_ids))
    peer.send(*(peer.update(each, 2) for each in var_ids), *(peer.summary(each, 9) for each in var_ids))
    peer.send(*(peer.request_create(each) for each in var_ids), *(peer.summary(each, 9) for each in var_ids))
    unknown = bench.unknown_id()
    peer.send(peer.summary(unknown, 1), peer.summary(unknown, 2), peer.summary(unknown, 3))
    bench.waiting.repeated(ICType.CREATE_VARIABLES, var_ids[-1], bench.mark())
    mark = peer.stimulate(*(peer.delete(each) for each in var_ids))
    bench.waiting.repeated(ICType.DELETE_VARIABLES, var_ids[-1], mark)
    kinds = {each.kind for heard in bench.heard for each in heard.instructions()}
    for heard in bench.heard:
        for number in range(len(heard.containers)):
            records = [each for each in heard.instructions() if each.container == number]
            named = [each.var_id for each in records]
            twice = [each for each in records if named.count(each.var_id) > 1]
            if twice:
                what = f"{named.count(twice[0].var_id)} records of variable {twice[0].var_id} in one container"
                bench.wrong("at most one record of each variable in each container", what, frames=twice)
    bench.some(
        len(kinds) >= 4,
        "at most one record of each variable in each container",
        seen=f"only {len(kinds)} kinds of containers were sent",
    )


@case(
    "TC_VD_PAY_BV_04",
    "Without anything to send there is no VarDis payload",
    requirements="VD-PAY-04 VD-IC-03",
    stimulus="a variable is created and deleted; then no more records",
    expect=(
        "no beacon has a VarDis block without containers; if no other variable is known, no beacon has a VarDis block"
    ),
    window=16,
)
def nothing_to_say(bench: Bench) -> None:
    peer, var_id = bench.peer(), bench.var_id()
    bench.learn(peer, peer.create(var_id))
    mark = peer.stimulate(peer.delete(var_id))
    bench.waiting.repeated(ICType.DELETE_VARIABLES, var_id, mark)
    quiet = bench.mark()
    bench.wait(5)
    empty = [each for each in bench.heard if each.has_vardis and not each.containers]
    bench.none(empty, "a container in every VarDis block")
    broken = [each for each in bench.heard if any(what.reason == "zero-count" for what in each.vardis_problems)]
    text = str(broken[0].vardis_problems[0]) if broken else ""
    bench.none(broken, "a record in every container", "VD-IC-03", seen=text)
    later = [each for each in bench.heard[quiet:] if each.has_vardis]
    told = [record for each in later for record in each.instructions()]
    if any(each.kind is ICType.SUMMARIES or each.var_id != var_id for each in told):
        # Without a reset, variables of earlier cases are still summarised.
        bench.info(
            "Is there a VarDis block if there is nothing to send?",
            "unknown: summaries of other variables are still sent",
        )
        return
    what = "no VarDis block when no instruction is pending"
    bench.none(later, what, "VD-PAY-04", given=bench.verdicts.in_time)


def _room_for_256(bench: Bench) -> str | None:
    needed = 2 * bench.builder.container_header_size + (IC_MAX_RECORDS + 1) * bench.profile.types.var_id.width
    if bench.sut.parameter(PAYLOAD_SIZE) < needed:
        return f"a payload has no room for {IC_MAX_RECORDS + 1} records of any kind"
    if len(_names(bench)) <= IC_MAX_RECORDS:
        return f"applications leave only {len(_names(bench))} identifiers to the tester (see pixit.var_ids)"
    return bench.sut.lacks("variables", IC_MAX_RECORDS + 1) or None


def _names(bench: Bench) -> set[int]:
    """Return one more variable identifier than a container can hold, of those that the tester may use."""
    pool = bench.session.identifier_pool
    usable = (each for each in range(pool.first, pool.first + pool.size) if not bench.identifiers.is_applications(each))
    return set(itertools.islice(usable, IC_MAX_RECORDS + 1))


@case(
    "TC_VD_PAY_BV_05",
    "A container has at most 255 records, and the 256th is not lost",
    requirements="VD-PAY-05",
    stimulus="summaries of 256 unknown variables",
    expect="requests for all 256, in well-formed containers",
    window=8,
    needs=Needs(ut=("UT-Reset",), when=_room_for_256),
)
def more_than_255(bench: Bench) -> None:
    peer = bench.peer()
    wanted = _names(bench)
    peer.send_all([peer.summary(each, 1) for each in sorted(wanted)])
    requested: set[int] = set()
    for _ in range(8):
        if requested == wanted:
            break
        bench.beacons(1, 4)
        requested = {each.var_id for each in bench.instructions(ICType.REQUEST_VARCREATES)}
    bench.every(bench.heard, lambda each: not each.vardis_problems, "VarDis payloads that can be decoded")
    came = f"requests for {len(requested)} variables"
    bench.some(requested == wanted, "requests for all 256 variables", seen=came, frames=bench.heard[-4:])


@case(
    "TC_VD_PAY_BV_06",
    "A short record does not overtake a long one that does not fit ({variant})",
    requirements="VD-PAY-06",
    alone=FILLS,
    stimulus="requests for more variables than fit into two payloads, every third of them with a short VarCreate",
    expect="the records in the order of the requests, across all payloads",
    window=12,
    variants={"creates": ICType.CREATE_VARIABLES, "updates": ICType.UPDATES},
)
def no_overtaking(bench: Bench, kind: ICType) -> None:
    peer = bench.peer()
    creates = stock(bench, peer, kind, mixed=True, seqno=9)
    mark = request(bench, peer, kind, creates)
    all_of(bench, kind, creates, mark)
    check_order_of_queue(bench, kind, [each.spec.var_id for each in creates], mark)


@case(
    "TC_VD_PAY_BV_08",
    "A payload has several containers of one type only if the PICS allows it, and never in 1.0",
    requirements="VD-IC-04",
    stimulus="summaries of 256 unknown variables: more than fit into one container",
    expect=(
        "if several_containers is denied, and in 1.0, one container of each type in a payload; if it is claimed, "
        "two in one"
    ),
    window=8,
    needs=Needs(ut=("UT-Reset",), when=_room_for_256),
)
def several_containers(bench: Bench) -> None:
    peer = bench.peer()
    peer.send_all([peer.summary(each, 1) for each in sorted(_names(bench))])
    bench.until_quiet(lambda heard: heard.instructions(ICType.REQUEST_VARCREATES), 12)
    several = [each for each in bench.heard if len({one.ic_type for one in each.containers}) < len(each.containers)]
    text = f"{len(several)} payloads with more"
    if not bench.features.several_containers_per_type:
        bench.none(several, "one container of each type in a payload (1.0)", seen=text)
    elif bench.sut.pics.several_containers is False:
        bench.none(several, "one container of each type in a payload, as the PICS claims", seen=text)
    elif bench.sut.pics.several_containers:
        bench.needed(several, "several containers of a type in a payload, as the PICS claims", "none observed")
        bench.passed("several containers of a type in a payload, as the PICS claims", frames=several[:2])
    else:
        bench.info("Does a payload have several containers of the same type?", "yes" if several else "not observed")
