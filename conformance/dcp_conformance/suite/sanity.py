"""The implementation is present and answers."""

from __future__ import annotations

from dataclasses import replace

from dcp_conformance.definitions.case import Needs, case
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.interconnection.basic_test import make_contact
from dcp_conformance.interconnection.contact import Contact
from dcp_conformance.interconnection.findings import Findings
from dcp_conformance.interconnection.settings import PERIODS
from dcp_conformance.test_system.bench import Bench


@case(
    "TC_DCP_SANITY_BV_01",
    "The implementation is present and takes part in the protocol",
    requirements="BP-RX-07",
    stimulus=(
        "a summary of an unknown variable; nothing without VarDis. Without an answer, other kinds of stimulus, "
        "other profiles, network identifiers and EtherTypes"
    ),
    expect="a request for the variable; without VarDis any beacon",
    window=8,
    needs=Needs(entities=()),
)
def sanity(bench: Bench) -> None:
    findings = Findings.of(bench.session)
    # The contact made by an earlier test must not excuse faults found by this one.
    findings.contact = None
    contact = make_contact(bench)
    try:
        _judge(bench, contact)
    finally:
        failed = (each for each in bench.verdicts.checks if each.verdict is Verdict.FAIL)
        blamed = frozenset(requirement for each in failed for requirement in each.requirements)
        findings.contact = replace(contact, blamed=blamed)
    if contact.trouble:
        raise UpperTesterError(contact.trouble)


def _judge(bench: Bench, contact: Contact) -> None:
    """Turn the contact into checks: broken rules first, then whether the implementation answers."""
    if contact.mistaken:
        bench.inconclusive("the same configuration of tester and implementation", contact.suspicion)
    for each, mark in contact.violations:
        bench.proved(False, each.expected, each.observed, each.requirement, frames=[mark])
    if contact.inactive:
        _judge_inactive(bench, contact)
    elif bench.sut.pics.vardis is False:
        _judge_beacons(bench, contact)
    else:
        _judge_answers(bench, contact)


def _judge_inactive(bench: Bench, contact: Contact) -> None:
    what = "BP is active after its start"
    if bench.session.can_restart or bench.services.offers("UT-Reset"):
        bench.wrong(what, contact.suspicion, "BP-INI-03")
    bench.inconclusive(what, f"{contact.suspicion}; it is unknown whether it has just started")


def _judge_beacons(bench: Bench, contact: Contact) -> None:
    """Check for a beacon; without VarDis that is sufficient."""
    what = "a beacon of the implementation"
    bench.needed(contact.frames, what, contact.suspicion)
    bench.passed(what)


def _judge_answers(bench: Bench, contact: Contact) -> None:
    what = "a beacon with a request for the variable of a summary"
    if "summary" not in contact.unanswered:
        # If the tester has no unknown variable left, the answer to another stimulus is sufficient.
        bench.some(contact.answered, what, seen=contact.answers())
        return
    observed = "; ".join(filter(None, (contact.suspicion, contact.answers())))
    if contact.odd:
        # It cannot be decided whether the request or its format is wrong.
        bench.inconclusive(what, f"{contact.odd} instead; {observed}")
    if contact.violations or not contact.beacons:
        bench.inconclusive(what, observed)
    if contact.loses_last:
        bench.missing(what, observed, "BP-RX-07", patience=PERIODS / 2)
    # Each stimulus was repeated, and has the same effect at any time: a small lateness explains no missing answer.
    if contact.answered & {"create", "request"}:
        bench.missing(what, observed, "VD-PS-01", patience=PERIODS / 2)
    if not _should_answer(bench):
        bench.inconclusive(what, f"{observed}; if the implementation has no VarDis, set vardis = false in [pics]")
    if "payload" not in contact.answered:
        bench.missing(what, f"no such beacon after several attempts; {observed}", patience=PERIODS / 2)
    # BP delivers payloads. Whether VarDis sends anything at all shows when an application creates a variable.
    mute = "variable" in contact.unanswered
    bench.missing(what, observed, "VD-RUN-02" if mute else "VD-PS-01", patience=PERIODS / 2)


def _should_answer(bench: Bench) -> bool:
    """Return whether the implementation is known to have VarDis."""
    upper = bench.session.upper
    services = upper is not None and any(method.startswith("RTDB-") for method in upper.methods)
    return bench.sut.pics.vardis is True or services or any(heard.has_vardis for heard in bench.heard)
