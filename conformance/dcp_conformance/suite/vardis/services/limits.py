"""dcp-vardis.md: Configurable Parameters, different maximum lengths of values and descriptions."""

from __future__ import annotations

from typing import NamedTuple

from dcp_spec.constants import ICType, SpecVersion

from dcp_conformance.definitions.case import Needs, Variant, case
from dcp_conformance.test_steps.services import (
    DESCRIPTION_TOO_LONG,
    OK,
    VALUE_TOO_LONG,
    create_request,
    parameters_set,
    produced,
)
from dcp_conformance.test_steps.variable_queries import ask
from dcp_conformance.test_system.bench import Bench

_VALUE, _DESCRIPTION = "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH"
_SHORT, _LONG = 8, 20


class Limits(NamedTuple):
    """Maximum lengths of values and of descriptions in octets."""

    value: int
    description: int


_SHORT_VALUES, _SHORT_DESCRIPTIONS = Limits(_SHORT, _LONG), Limits(_LONG, _SHORT)
_SET = ("VD-SetParameter",)


def _nul(bench: Bench) -> int:
    """Return 1 if the parameter counts the NUL at the end of a description (1.0), else 0."""
    return 1 if bench.features.string_format == "nul-terminated" else 0


@case(
    "TC_VD_LEN_BV_02",
    "Lengths of received values and descriptions are each compared with their own maximum ({variant})",
    requirements="VD-PC-04 VD-PC-05 VD-PU-04",
    stimulus=(
        "the two maximum lengths are set to 8 and 20 octets; VarCreates and VarUpdates with lengths up to and "
        "above each"
    ),
    expect="records are stored if each length is within its own maximum, and ignored otherwise",
    window=30,
    needs=Needs(since=SpecVersion.V1_1, ut=_SET),
    variants={"short-values": _SHORT_VALUES, "short-descriptions": _SHORT_DESCRIPTIONS},
)
def received(bench: Bench, limits: Limits) -> None:
    with parameters_set(bench, "VD", **{_VALUE: limits.value, _DESCRIPTION: limits.description}):
        peer = bench.peer()
        for value, description, requirement in (
            (limits.value, limits.description, ""),
            (limits.value + 1, 1, "VD-PC-04"),
            (1, limits.description + 1, "VD-PC-05"),
        ):
            record = peer.create(bench.unknown_id(), value=b"v" * value, descr=b"d" * description, exact=True)
            bench.identifiers.created.add(record.spec.var_id)
            peer.send(record)
            what = f"a VarCreate with a value of {value} octets and a description of {description}"
            wrong = ("VD-PC-04", "VD-PC-05") if not requirement else (requirement,)
            if requirement:
                bench.require_processed(what)
                found = bench.instructions(ICType.CREATE_VARIABLES, record.spec.var_id)
                bench.none(found, f"{what} is ignored", *wrong)
            else:
                sent_on = bench.until_instruction(ICType.CREATE_VARIABLES, record.spec.var_id)
                bench.some(sent_on, f"{what} is forwarded", *wrong)
        known = bench.learnt(peer, bench.unknown_id(), value=b"v", descr=b"d")
        name = known.spec.var_id
        peer.send(peer.update(name, 1, b"v" * limits.value, exact=True))
        stored = bench.until_instruction(ICType.UPDATES, name)
        bench.some(stored, f"a VarUpdate with a value of {limits.value} octets is forwarded", "VD-PU-04")
        mark = peer.stimulate(peer.update(name, 2, b"v" * (limits.value + 1), exact=True))
        held = ask(bench, name)
        wrong_update = [each for each in bench.instructions(ICType.UPDATES, name, mark) if each.record.seqno == 2]
        taken = wrong_update or (held.record is not None and held.record.upd.seqno == 2)
        what = f"a VarUpdate with a value of {limits.value + 1} octets is ignored"
        bench.none(taken, what, "VD-PU-04", seen=held, frames=wrong_update)


@case(
    "TC_VD_LEN_BV_03",
    "Lengths of an application's values and descriptions are each compared with their own maximum ({variant})",
    requirements="VD-CRE-04 VD-CRE-05",
    stimulus=(
        "the two maximum lengths are set to 8 and 20 octets; RTDB-Create and RTDB-Update with lengths up to and "
        "above each"
    ),
    expect=(
        "VARDIS-STATUS-OK if each length is within its own maximum, otherwise VALUE-TOO-LONG or DESCRIPTION-TOO-LONG"
    ),
    window=10,
    needs=Needs(ut=(*_SET, "RTDB-Create")),
    variants={
        "short-values": Variant(_SHORT_VALUES),
        "short-descriptions": Variant(_SHORT_DESCRIPTIONS),
        "updates": Variant(
            _SHORT_VALUES, requirements="VD-UPD-05", needs=Needs(ut=(*_SET, "RTDB-Create", "RTDB-Update"))
        ),
    },
)
def served(bench: Bench, limits: Limits) -> None:
    longest = limits.description - _nul(bench)
    with parameters_set(bench, "VD", **{_VALUE: limits.value, _DESCRIPTION: limits.description}):
        if bench.case.requirements == ("VD-UPD-05",):
            var_id = produced(bench, value=b"v", descr="d")
            for length, status in ((limits.value, OK), (limits.value + 1, VALUE_TOO_LONG)):
                bench.expect_status(status, "RTDB-Update", varId=var_id, value=(b"v" * length).hex())
            return
        for value, description, status, requirement in (
            (limits.value, longest, OK, ""),
            (limits.value + 1, 1, VALUE_TOO_LONG, "VD-CRE-05"),
            (1, longest + 1, DESCRIPTION_TOO_LONG, "VD-CRE-04"),
        ):
            request = create_request(
                bench, bench.identifiers.own_var_id(), value=b"v" * value, descr="d" * description, exact=True
            )
            bench.expect_status(status, "RTDB-Create", *filter(None, (requirement,)), **request)
