"""Fields that the implementation reads differently from the profile, and the failures that follow from that.

One such fault has many consequences: an implementation that compares creation times in the wrong byte order keeps the
older of two variables, and one with another layout of state reports stores none of the tester's. The cases about data
types and formats fail for the fault. Its consequences in other cases are inconclusive.
"""

from __future__ import annotations

import itertools
from collections.abc import Mapping
from contextlib import suppress
from typing import Final

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.test_steps.services import create_request
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.known import Failure, Misread
from dcp_conformance.test_system.traffic import payloads, records

OWNERS: Final = frozenset(
    {"DATA-01", "DATA-02", "DATA-03", "DATA-05", "SRP-FMT-01", "SRP-TYP-02", "SRP-TYP-03", "VD-TYP-05"}
)
"""The requirements about layouts: a misread field never excuses their failures."""
_CREATION_OWNERS: Final = frozenset({"VD-PC-07", "VD-PC-09", "VD-CMP-06"})
"""The requirements to forward a VarCreate: a misread VarCreate never excuses a check about them alone."""
_DAY: Final = 86_400 * 10**9
_TABLE: Final = "SRP-NeighbourTable"
_UPDATE: Final = "SRP-UpdateSafetyData"
_CREATE: Final = "RTDB-Create"
#: Number of attempts, because frames may be lost.
_ATTEMPTS: Final = 2


def misread_fields(bench: Bench) -> dict[Misread, str]:
    """Return the fields that the implementation misreads, each with a text about the observation.

    Takes about six beacon periods and deletes its variables. Raises ``LowerTesterError``.
    """
    found: dict[Misread, str] = {}
    forwarded, asked = _accepts_creations(bench)
    if not forwarded and (text := _own_records(bench)):
        found["VarDis"] = text
    elif not forwarded and asked:
        found["VarCreate"] = "it forwarded no VarCreate at the start of the run (VD-PC-09)"
    elif forwarded and (text := _creation_times(bench)):
        found["creationTime"] = text
    # The next case that needs the upper tester reports an error of it.
    with suppress(UpperTesterError):
        if text := _reports(bench):
            found["report"] = text
    return found


def _accepts_creations(bench: Bench) -> tuple[bool, bool]:
    """Return whether VarCreates are forwarded (VD-PC-09), and whether the variable is requested after a summary of it.

    With another layout of VarSpecT no VarCreate is accepted. An implementation that does not even request the variable
    has another fault than this layout.
    """
    if not bench.identifiers.has_unknown_ids():
        return True, False
    asked = False
    for _ in range(_ATTEMPTS):
        peer = bench.peer()
        create = peer.create(bench.var_id())
        peer.send(create)
        if bench.until_instruction(ICType.CREATE_VARIABLES, create.spec.var_id) is not None:
            peer.send(peer.delete(create.spec.var_id))
            # The VarDelete has one repetition, so no wait for further ones is needed.
            bench.until_instruction(ICType.DELETE_VARIABLES, create.spec.var_id)
            return True, False
        peer.send(peer.summary(create.spec.var_id, 0))
        asked |= bench.until_instruction(ICType.REQUEST_VARCREATES, create.spec.var_id) is not None
    return False, asked


def _own_records(bench: Bench) -> str:
    """Describe a fault in the layout of the implementation's own VarCreate; empty if it has none, or none came."""
    if not bench.services.offers(_CREATE) or not bench.identifiers.has_unknown_ids():
        return ""
    with suppress(UpperTesterError):
        var_id = bench.identifiers.own_var_id()
        if bench.call(_CREATE, **create_request(bench, var_id, timeout=60_000)).ok:
            bad = bench.until(lambda heard: heard.vardis_problems)
            bench.call("RTDB-Delete", varId=var_id)
            return f"its own records of VarDis are laid out otherwise: {bad[0]}" if bad else ""
    return ""


# -- creation times ----------------------------------------------------------------------------------------------------


def _creation_times(bench: Bench) -> str:
    """Return a text if creation times are compared in the wrong byte order; empty if not, or if it is unknown.

    Creates two variables, and both again by another producer: one with a later time that is earlier with swapped
    octets, the other one the other way round. The later creation replaces the stored one (VD-PC-01).
    """
    if "creationTime" not in bench.profile.vardis.var_spec or not bench.identifiers.has_unknown_ids(2):
        return ""
    early = (bench.records.creation_time() >> 8 << 8) + 0x17F
    later = early + 0x82
    bench.session.creation_time = later
    one, two = bench.identifiers.var_ids(2)
    first, second = bench.peer(), bench.peer()

    def forwarded(since: int, var_id: int, producer: bytes) -> bool:
        found = bench.instructions(ICType.CREATE_VARIABLES, var_id, since)
        return any(each.record.spec.prod_id == producer for each in found)

    since = bench.mark()
    first.send_all([first.create(one, creation_time=early), first.create(two, creation_time=later)])
    bench.until(lambda _: all(forwarded(since, each, first.node_id) for each in (one, two)))
    known = all(forwarded(since, each, first.node_id) for each in (one, two))
    since = bench.mark()
    second.send_all([second.create(one, creation_time=later), second.create(two, creation_time=early)])
    bench.until(lambda _: forwarded(since, one, second.node_id))
    right, wrong = (forwarded(since, each, second.node_id) for each in (one, two))
    since = bench.mark()
    # Each variable is deleted by both producers: the implementation may have stored either.
    first.send_all([first.delete(each) for each in (one, two)])
    second.send_all([second.delete(each) for each in (one, two)])
    bench.until(lambda _: all(bench.instructions(ICType.DELETE_VARIABLES, each, since) for each in (one, two)))
    if not known or right or not wrong:
        return ""
    return "it compares creation times as if their octets were in the other order (DATA-01)"


# -- state reports -----------------------------------------------------------------------------------------------------


def stores_reports(bench: Bench) -> bool:
    """Send a state report; return whether its node is in the neighbour table two beacon periods later.

    Raises ``LowerTesterError`` and ``UpperTesterError``.
    """
    peer = bench.peer()
    peer.send(bench.records.report(peer.node_id, 1))
    bench.wait(2)
    rows = bench.call(_TABLE).result.get("neighbours")
    listed = [str(each.get("nodeId", "")) for each in rows if isinstance(each, dict)] if isinstance(rows, list) else []
    return peer.node_id.hex() in [each.replace(":", "").lower() for each in listed]


def _reports(bench: Bench) -> str:
    """Describe a fault of the implementation's state reports if it stores none of the tester's; empty otherwise."""
    layout = bench.profile.srp.safety_data
    if not bench.services.offers(_TABLE, _UPDATE) or bench.sut.pics.srp is False:
        return ""
    if not bench.profile.srp.is_report or any(each.type == "opaque" for each in layout):
        return ""
    if any(stores_reports(bench) for _ in range(_ATTEMPTS)):
        return ""
    if not bench.call(_UPDATE, sData={each.name: 1 for each in layout}).ok:
        return ""
    bad = bench.until(lambda heard: heard.report_problems)
    return f"its own state reports are laid out otherwise: {bad[0]}" if bad else ""


# -- consequences ------------------------------------------------------------------------------------------------------


def cause(misread: Mapping[Misread, str], failure: Failure) -> str:
    """Return the text about the misread field that a failed check follows from; empty if there is none."""
    if OWNERS & failure.requirements:
        return ""
    for each in failure.relied:
        if each in misread:
            return misread[each]
    if "VarDis" in misread and _about_records(failure):
        return misread["VarDis"]
    if "creationTime" in failure.relied and _backwards(failure):
        return "its own creationTimes are times of today only with their octets swapped (DATA-01)"
    if "creationTime" in misread and _disordered(failure):
        return misread["creationTime"]
    if failure.shown or not misread:
        return ""
    sent = list(payloads(failure.codec, failure.events))
    created = any(isinstance(record, VarCreate) for payload in sent for record in records(payload))
    if "VarCreate" in misread and created and not failure.requirements <= _CREATION_OWNERS:
        return misread["VarCreate"]
    return misread["report"] if "report" in misread and any(each.srp is not None for each in sent) else ""


def _about_records(failure: Failure) -> bool:
    """Return whether a failed check is about VarDis, but not about the octets of containers.

    If something is missing, it may also be about the data types in its records.
    """
    about = ("VD-",) if failure.shown else ("VD-", "DATA-")
    return all(each.startswith(about) and not each.startswith("VD-IC-") for each in failure.requirements)


def _backwards(failure: Failure) -> bool:
    """Return whether a VarCreate of the implementation's own variables has the current day only with swapped octets.

    False if the clock of the profile has no epoch.
    """
    stamp = failure.codec.profile.types.timestamp
    if stamp.epoch_ns is None:
        return False

    def today(ticks: int) -> bool:
        assert stamp.epoch_ns is not None
        return abs(stamp.epoch_ns + stamp.nanoseconds(ticks) - failure.wall) < _DAY

    specs = [each.record.spec for one in failure.heard for each in one.instructions(ICType.CREATE_VARIABLES)]
    times = [each.creation_time for each in specs if each.prod_id == failure.sut_id and each.creation_time is not None]
    return any(not today(each) and any(map(today, _swapped(each, stamp.width))) for each in times)


def _disordered(failure: Failure) -> bool:
    """Return whether swapped octets change the order of two creationTimes of one variable, sent or received."""
    times: dict[int, set[int]] = {}
    for payload in payloads(failure.codec, failure.events, "heard"):
        for each in records(payload):
            if isinstance(each, VarCreate) and each.spec.creation_time is not None:
                times.setdefault(each.spec.var_id, set()).add(each.spec.creation_time)
    width = failure.codec.profile.types.timestamp.width
    pairs = (pair for found in times.values() for pair in itertools.combinations(sorted(found), 2))
    return any(a > b for one, two in pairs for a, b in zip(_swapped(one, width), _swapped(two, width), strict=True))


def _swapped(value: int, width: int) -> tuple[int, int]:
    """Return the number with its octets in the other order, as an unsigned and as a signed number."""
    octets = (value % (1 << (8 * width))).to_bytes(width, "little")
    return int.from_bytes(octets, "big"), int.from_bytes(octets, "big", signed=True)
