"""dcp-vardis.md: VarDis Application Service Interface, the order of checks.

If a request has two mistakes, the first failing check determines the status. The module for RTDB-Create tests its own
order.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from dcp_spec.constants import SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import (
    INACTIVE,
    NOT_EXPRESSIBLE,
    NOT_PRODUCER,
    UNKNOWN,
    create_request,
    deleted_by_peer,
    deleted_status,
    expect_any,
    longest_description,
    max_repetitions,
    or_removed,
    produced,
    settled,
    teach_variable,
    too_long,
)
from dcp_conformance.test_system.bench import Bench

_MANAGE = ("VD-MGMT-Activate", "VD-MGMT-Deactivate")


def _several(bench: Bench) -> int:
    """Return a repetition count for which, up to 1.3, a deleted variable remains in the database for a while."""
    return min(5, max_repetitions(bench))


def _own_deleted(bench: Bench) -> int:
    var_id = produced(bench, rep_cnt=_several(bench))
    settled(bench, var_id)
    bench.must("RTDB-Delete", varId=var_id)
    return var_id


def _foreign_deleted(bench: Bench) -> int:
    return deleted_by_peer(bench, _several(bench))


def _unknown(bench: Bench) -> int:
    return bench.unknown_id()


def _foreign(bench: Bench) -> int:
    return teach_variable(bench, bench.peer())


def _asked(bench: Bench, statuses: tuple[str, ...], method: str, *requirements: str, **params: Any) -> None:
    """Check the status of a request with two mistakes; report only if the profile cannot express the request."""
    answer = bench.call(method, **params)
    if answer.code == NOT_EXPRESSIBLE:
        bench.info("Can the profile express the request?", str(answer))
        return
    bench.services.check_status(answer, statuses, method, *requirements)


_Two = tuple[str, Callable[[Bench], int], Callable[[Bench], bytes] | bytes]
_DELETED = Needs(ut=("RTDB-Update", "RTDB-Create", "RTDB-Delete"))


@case(
    "TC_VD_UPD_BI_04",
    "The first failing check of RTDB-Update determines the status ({variant})",
    requirements="VD-UPD-11",
    stimulus="RTDB-Update with two mistakes ({variant})",
    expect="the status of the first failing check",
    needs=Needs(ut=("RTDB-Update",)),
    variants={
        "unknown+long": (UNKNOWN, _unknown, too_long),
        "unknown+empty": (UNKNOWN, _unknown, b""),
        "foreign+long": (NOT_PRODUCER, _foreign, too_long),
        "foreign+empty": (NOT_PRODUCER, _foreign, b""),
        "foreign+deleted": (NOT_PRODUCER, _foreign_deleted, b"\0"),
        "deleted+long": Variant(("", _own_deleted, too_long), needs=_DELETED),
        "deleted+empty": Variant(("", _own_deleted, b""), needs=_DELETED),
    },
)
def update(bench: Bench, mistakes: _Two) -> None:
    status, variable, value = mistakes
    octets = value if isinstance(value, bytes) else value(bench)
    status = status or deleted_status(bench)
    statuses = or_removed(bench, status) if variable in (_own_deleted, _foreign_deleted) else (status,)
    # The first mistake is not about a length, so assumed maxima do not matter.
    bench.assumptions.discard()
    _asked(bench, statuses, "RTDB-Update", varId=variable(bench), value=octets.hex())


@case(
    "TC_VD_DEL_BI_02",
    "RTDB-Delete checks the producer before it checks whether the variable is deleted",
    requirements="VD-DEL-07",
    stimulus="RTDB-Delete for a deleted variable of a peer",
    expect="VARDIS-STATUS-NOT-PRODUCER",
    needs=Needs(ut=("RTDB-Delete",)),
)
def delete(bench: Bench) -> None:
    expect_any(bench, or_removed(bench, NOT_PRODUCER), "RTDB-Delete", varId=_foreign_deleted(bench))


def _create_mistakes(bench: Bench) -> list[dict[str, Any]]:
    taken, free = _foreign(bench), bench.unknown_id()
    longest = longest_description(bench)
    return [
        create_request(bench, taken),
        create_request(bench, free, descr="d" * (longest + 1), value=b"v", exact=True),
        create_request(bench, free, value=too_long(bench), descr="d", exact=True),
        create_request(bench, free, value=b""),
        create_request(bench, free, rep_cnt=0),
    ]


def _mistaken(bench: Bench) -> list[int]:
    """Return identifiers of variables that are unknown, produced by another node, or deleted, as far as the upper
    tester can create them.
    """
    deletes = bench.services.offers("RTDB-Create", "RTDB-Delete")
    own = [produced(bench, rep_cnt=_several(bench))] if deletes else []
    for each in own:
        settled(bench, each)
    found = [bench.unknown_id(), _foreign(bench), _foreign_deleted(bench), *own]
    for each in own:
        # Deleted last: up to 1.3 the variable exists only while its deletion is repeated.
        bench.must("RTDB-Delete", varId=each)
    return found


def _update_mistakes(bench: Bench) -> list[dict[str, Any]]:
    alive: list[dict[str, Any]] = [{"varId": _foreign(bench), "value": each} for each in (too_long(bench).hex(), "")]
    if bench.services.offers("RTDB-Create"):
        own = produced(bench)
        alive += [{"varId": own, "value": each} for each in (too_long(bench).hex(), "")]
    return [*alive, *({"varId": each, "value": "00"} for each in _mistaken(bench))]


def _by_variable(bench: Bench) -> list[dict[str, Any]]:
    return [{"varId": each} for each in _mistaken(bench)]


def _needs(method: str) -> Needs:
    return Needs(since=SpecVersion.V1_2, ut=(method, *_MANAGE))


@case(
    "TC_VD_MGT_BO_09",
    "Inactive VarDis rejects a request as inactive, even if the request has other mistakes ({variant})",
    requirements="VD-MGT-04",
    stimulus="VD-MGMT-Deactivate; requests of {variant}, each with one mistake",
    expect="VARDIS-STATUS-INACTIVE each time",
    needs=Needs(since=SpecVersion.V1_2, ut=_MANAGE),
    variants={
        "RTDB-Create": Variant(
            ("RTDB-Create", _create_mistakes), requirements="VD-CRE-13 VD-CRE-01 VD-MGT-04", needs=_needs("RTDB-Create")
        ),
        "RTDB-Update": Variant(
            ("RTDB-Update", _update_mistakes), requirements="VD-UPD-11 VD-UPD-01 VD-MGT-04", needs=_needs("RTDB-Update")
        ),
        "RTDB-Delete": Variant(
            ("RTDB-Delete", _by_variable), requirements="VD-DEL-07 VD-DEL-01 VD-MGT-04", needs=_needs("RTDB-Delete")
        ),
        "RTDB-Read": Variant(
            ("RTDB-Read", _by_variable), requirements="VD-REA-05 VD-REA-01 VD-MGT-04", needs=_needs("RTDB-Read")
        ),
        "RTDB-DescribeVariable": Variant(
            ("RTDB-DescribeVariable", _by_variable),
            requirements="VD-DVA-01 VD-MGT-04",
            needs=_needs("RTDB-DescribeVariable"),
        ),
    },
)
def inactive_first(bench: Bench, variant: tuple[str, Callable[[Bench], list[dict[str, Any]]]]) -> None:
    method, mistakes = variant
    requests = mistakes(bench)
    bench.assumptions.discard()
    with bench.services.deactivated("VD"):
        for request in requests:
            _asked(bench, (INACTIVE,), method, **request)
