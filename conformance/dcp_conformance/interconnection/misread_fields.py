"""Find out at the start of a run which fields the implementation reads differently from the profile."""

from __future__ import annotations

from contextlib import suppress
from typing import Final

from dcp_spec.constants import ICType

from dcp_conformance.errors import UpperTesterError
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.test_system.judgement.misreading import Field

_TABLE: Final = "SRP-NeighbourTable"
_UPDATE: Final = "SRP-UpdateSafetyData"
#: Number of attempts, because frames may be lost.
_ATTEMPTS: Final = 2


def misread_fields(bench: Bench) -> dict[Field, str]:
    """Return the fields that the implementation misreads, each with a text about the observation.

    Takes about six beacon periods and deletes its variables. Raises ``LowerTesterError``.
    """
    found: dict[Field, str] = {}
    if not _accepts_creations(bench):
        found["VarCreate"] = "it forwarded no VarCreate at the start of the run (VD-PC-09)"
    elif text := _creation_times(bench):
        found["creationTime"] = text
    # The next case that needs the upper tester reports an error of it.
    with suppress(UpperTesterError):
        if text := _reports(bench):
            found["report"] = text
    return found


def _accepts_creations(bench: Bench) -> bool:
    """Return whether VarCreates are forwarded (VD-PC-09): with another layout of VarSpecT none is accepted.

    Such an implementation requests the variable after a summary of it. An implementation that does not even request it
    has another fault than the layout, which excuses nothing.
    """
    if not bench.identifiers.has_unknown_ids():
        return True
    asked = False
    for _ in range(_ATTEMPTS):
        peer = bench.peer()
        create = peer.create(bench.var_id())
        peer.send(create)
        if bench.until_instruction(ICType.CREATE_VARIABLES, create.spec.var_id) is not None:
            peer.send(peer.delete(create.spec.var_id))
            # The VarDelete has one repetition, so no wait for further ones is needed.
            bench.until_instruction(ICType.DELETE_VARIABLES, create.spec.var_id)
            return True
        peer.send(peer.summary(create.spec.var_id, 0))
        asked |= bench.until_instruction(ICType.REQUEST_VARCREATES, create.spec.var_id) is not None
    return not asked


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
    upper = bench.session.upper
    layout = bench.profile.srp.safety_data
    if upper is None or not {_TABLE, _UPDATE} <= upper.methods or bench.sut.pics.srp is False:
        return ""
    if not bench.profile.srp.is_report or any(each.type == "opaque" for each in layout):
        return ""
    if any(stores_reports(bench) for _ in range(_ATTEMPTS)):
        return ""
    if not bench.call(_UPDATE, sData={each.name: 1 for each in layout}).ok:
        return ""
    bad = bench.until(lambda heard: heard.report_problems)
    return f"its own state reports are laid out otherwise: {bad[0]}" if bad else ""
