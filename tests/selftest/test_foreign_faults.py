"""Faults and limits of other implementations that were once passed, excused, or charged to another requirement."""

from __future__ import annotations

import pytest
from dcp_conformance.definitions.case import SANITY, all_cases
from dcp_conformance.diagnosis import explain, load
from dcp_selftest.mutants import all_mutants
from dcp_selftest.runner import Suite
from dcp_selftest.variants.campaign import judge
from dcp_selftest.variants.variant import Variant, setup, slow

from ..parts import every

PROFILE = "dcp-2.0"
#: Mutant, duration of a call in ms, cases, and the case and requirement that must fail.
FAULTS = {
    "260 submissions in two beacons": ("M-BP-TX-08-any-number", 1, (), "TC_BP_TX_BV_05", "BP-TX-08"),
    "a hang at one octet too many": ("M-BP-TX-04-hangs", 0, (), "TC_BP_TX_BV_01-one-octet", "BP-TX-04"),
    "exchanged fields in repeated reports": ("M-SRP-TYP-03-exchanged-again", 0, (), "TC_SRP_REC_BV_02", "SRP-TYP-03"),
    "a timeout that never expires": (
        "M-VD-TYP-04-signed", 0, ("TC_VD_SCR_TI_01-200",), "TC_VD_SCR_TI_12-received", "VD-SCR-01",
    ),
}  # fmt: skip


@pytest.mark.parametrize("what", every(2, FAULTS))
def test_it_fails_the_requirement(what: str) -> None:
    mutant, call_ms, before, case, requirement = FAULTS[what]
    made = setup(PROFILE, make=all_mutants()[mutant].make, upper=slow(call_ms))
    chosen = [all_cases()[name] for name in (SANITY, *before, case)]
    found = {
        each.case: each.requirements for each in judge(Variant("V-X", "", "", lambda _: made), PROFILE, chosen).fails
    }
    assert requirement in found.get(case, ()), found


#: Faults of the public C++ implementation, and the mutants that the diagnosis names for them.
IN_THE_DICTIONARY = {
    "a queue that is peeked when empty": "M-BP-CLR-03-dies-of-empty",
    "a call that blocks on a full queue": "M-BP-QM-01-dies-of-full",
    "a beacon that overflows by a header": "M-BP-TX-04-dies-of-overflow",
    "fifteen places at most": "M-BP-QM-01-at-most-16",
    "queues lost while inactive": "M-BP-MGT-04-forgets",
    "reports sent again with a new number": "M-SRP-SEQ-01-sent-again",
}


@pytest.mark.parametrize("what", IN_THE_DICTIONARY)
def test_the_diagnosis_names_it(what: str) -> None:
    name = IN_THE_DICTIONARY[what]
    (fault,) = (each for each in load().faults if each.id == name)
    mutant = all_mutants()[name]
    chosen = [all_cases()[case] for case in sorted(fault.fails)]
    diagnosis = explain(Suite(mutant.profile, mutant.make).run(chosen), load())
    assert [each.fault for each in diagnosis.faults] == [name]
    assert diagnosis.faults[0].likely
    assert not diagnosis.unexplained + diagnosis.ended
