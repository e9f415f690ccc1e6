"""The implementation is there."""

from __future__ import annotations

from dataclasses import replace

from dcp_conformance.bench import Bench
from dcp_conformance.case import Needs, case
from dcp_conformance.contact import Contact
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.interconnection import make_contact
from dcp_conformance.verdict import Verdict


@case(
    "TC_DCP_SANITY_BV_01",
    "The implementation is there and takes part in the protocol",
    requirements="BP-RX-07",
    stimulus="a summary of a variable that nobody knows; without VarDis nothing. If that is not answered, other kinds "
    "of stimulus, other profiles, network identifiers and EtherTypes",
    expect="a request for it in a beacon; without VarDis any beacon",
    window=8,
    needs=Needs(entities=()),
    smoke=True,
)
def sanity(bench: Bench) -> None:
    # What an earlier test has found must not excuse what this one finds.
    bench.session.contact = None
    contact = make_contact(bench)
    try:
        _judge(bench, contact)
    finally:
        failed = (each for each in bench.checks if each.verdict is Verdict.FAIL)
        blamed = frozenset(requirement for each in failed for requirement in each.requirements)
        bench.session.contact = replace(contact, blamed=blamed)
    if contact.trouble:
        raise UpperTesterError(contact.trouble)


def _judge(bench: Bench, contact: Contact) -> None:
    """Turn what was found into checks: broken rules first, then whether the implementation answers."""
    if contact.mistaken:
        bench.inconclusive("tester and implementation are set up alike", contact.suspicion)
    for each in contact.violations:
        bench.check(False, each.expected, each.observed, each.requirement, frames=[each.mark], shown=True)
    if contact.inactive:
        _judge_inactive(bench, contact)
    elif bench.pics.vardis is False:
        _judge_beacons(bench, contact)
    else:
        _judge_answers(bench, contact)


def _judge_inactive(bench: Bench, contact: Contact) -> None:
    what = "BP is active after its start"
    upper = bench.session.upper
    if bench.session.can_restart or (upper is not None and "UT-Reset" in upper.methods):
        bench.fail(what, contact.suspicion, "BP-INI-03", shown=True)
    bench.inconclusive(what, f"{contact.suspicion}; whether it has just started is not known")


def _judge_beacons(bench: Bench, contact: Contact) -> None:
    """Without VarDis a beacon is enough."""
    what = "a beacon of the implementation"
    if not contact.frames:
        bench.inconclusive(what, contact.suspicion)
    bench.check(True, what)


def _judge_answers(bench: Bench, contact: Contact) -> None:
    what = "a beacon that requests the variable of a summary"
    if "summary" not in contact.unanswered:
        # Where no variable is left that it does not know, another question has to do.
        bench.check(contact.answered, what, contact.answers())
        return
    observed = "; ".join(filter(None, (contact.suspicion, contact.answers())))
    if contact.odd:
        # Whether the request or its form is wrong, this cannot tell.
        bench.inconclusive(what, f"{contact.odd} instead; {observed}")
    if contact.violations or not contact.beacons:
        bench.inconclusive(what, observed)
    if contact.answered & {"create", "request"}:
        bench.fail(what, observed, "VD-PS-01")
    if not _should_answer(bench):
        bench.inconclusive(what, f"{observed}; does it have VarDis? If not, give [pics] vardis = false")
    if "payload" not in contact.answered:
        bench.fail(what, f"no such beacon after several attempts; {observed}")
    # BP delivers payloads. What an application creates shows whether VarDis sends anything at all.
    mute = "variable" in contact.unanswered
    bench.fail(what, observed, "VD-RUN-02" if mute else "VD-PS-01")


def _should_answer(bench: Bench) -> bool:
    """Whether the implementation is known to have VarDis."""
    upper = bench.session.upper
    services = upper is not None and any(method.startswith("RTDB-") for method in upper.methods)
    return bench.pics.vardis is True or services or any(heard.has_vardis for heard in bench.heard)
