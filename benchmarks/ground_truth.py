"""Results of ``check``, ``why`` and pages for recordings with a ground truth: writes ``docs/ground-truth.md``.

``python benchmarks/ground_truth.py [--short]``: lines of five simulated nodes, whose databases are known at each
second, with one faulty node in the middle. ``--short`` judges fewer of them and prints the page. Exit status: 1 if an
answer contradicts a database, if a node without a fault is blamed, or if page and check differ.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from dcp_conformance.check import Judge
from dcp_conformance.check.base import name
from dcp_conformance.check.topology import told
from dcp_conformance.check.why import Answer, Step, why
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import RunResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_selftest.recordings.lines import FAULTS, FAULTY, LINKS, NODES, PROFILE, record_line, recorded
from dcp_spec.markdown import table
from dcp_tables.report.analysis import time_of
from dcp_tables.report.holding import holding
from dcp_tables.report.recorded import gather

from dcp_codec.analysis.guess import guess, sample
from dcp_codec.capture import Frame, create_capture, open_capture
from dcp_codec.codec import Codec

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "ground-truth.md"
LOSSES = (0.0, 0.1, 0.3)


class Question(NamedTuple):
    """A question for ``why``. ``second`` is the time in the simulation."""

    fault: str
    variable: int
    node: int
    second: int
    stops: bool
    """True if the faulty node does not forward newer values."""


QUESTIONS = (
    Question("stuck", 1, 4, 13, stops=False),
    Question("stuck", 1, 4, 30, stops=True),
    Question("one direction", 5, 0, 20, stops=True),
    Question("one deletion", 14, 2, 30, stops=True),
    Question("first container", 1, 3, 25, stops=True),
)


def judged(frames: Iterable[Frame], profile: str, links: str = "") -> tuple[Judge, RunResult]:
    """Judge frames, with links as in ``check --hears``."""
    judge = Judge(
        Codec(profile), Pics(), recording="line", period_known=False, topology=told([links]) if links else None
    )
    for frame in frames:
        judge.feed(frame)
    return judge, judge.result()


def short(text: str) -> str:
    """Shorten the node identifiers of a text."""
    return text.replace("02:00:00:00:", "")


# -- why ---------------------------------------------------------------------------------------------------------------


def answered(question: Question) -> tuple[Answer, list[int | None], bool]:
    """Return the answer, the numbers in the databases, and whether they agree."""
    line = record_line(question.fault)
    judge, _ = judged(line.frames, PROFILE, LINKS)
    seconds = question.second + (line.begin - line.frames[0].time_ns) / 1e9
    answer = why(judge, question.variable, f"00:0{question.node}", seconds)
    numbers = [line.numbers[question.second, node, question.variable] for node in range(5)]
    held = numbers[question.node]
    good = answer.holds.text.startswith("has deleted" if held is None else f"holds {held} ")
    stops = [step for step in answer.stopped if step.node == name(NODES[FAULTY])]
    return answer, numbers, good and bool(stops) == question.stops


def questions(asked: Sequence[Question]) -> tuple[list[str], bool]:
    """Return the section about ``why``, and whether all answers agree with the databases."""
    lines, every = [], True
    for number, question in enumerate(asked, 1):
        answer, numbers, agrees = answered(question)
        every &= agrees
        shown = " ".join("-" if each is None else str(each) for each in numbers)
        lines += [
            f'{number}. Fault "{question.fault}": why does node 00:0{question.node} have this value of variable '
            f"{question.variable} at {question.second} s? In the databases of nodes 00:00 to 00:04: {shown}. "
            f"{'The answer agrees' if agrees else '**The answer differs**'}:",
            "",
            "   ```",
            *(f"   {each}" for each in printed(answer)),
            "   ```",
            "",
        ]
    return lines, every


def printed(answer: Answer) -> list[str]:
    """Return the lines of an answer."""

    def line(step: Step) -> str:
        frame = f"frame {step.frame}" if step.frame else ""
        return short(f"  {frame:<11} {step.node}  {step.text}".rstrip())

    found = [short(f"{answer.holds.node} {answer.holds.text} (frame {answer.holds.frame})")]
    for title, steps in (("How it came there:", answer.came), ("Where newer values stop:", answer.stopped)):
        if steps:
            found += [title, *map(line, steps)]
    return found


# -- check -------------------------------------------------------------------------------------------------------------


def outcome(fault: str, loss: float, links: str) -> tuple[str, str, int]:
    """Return the result of a line, the rules or the observation, and the number of false findings."""
    judge, run = judged(recorded(fault, loss), PROFILE, links)
    found = [
        (each.verdict, case.id, each.observed)
        for case in run.cases
        for each in case.checks
        if each.verdict in (Verdict.FAIL, Verdict.INCONCLUSIVE)
        or (each.verdict is Verdict.INFO and case.id in ("CK_NET_AGREES", "CK_VD_ENDLESS"))
    ]
    faulty = name(NODES[FAULTY])
    fails = [each for each in found if each[0] is Verdict.FAIL]
    false = sum(not text.startswith(faulty) for _, _, text in fails) if fault else len(fails)
    if right := [rule for _, rule, text in fails if text.startswith(faulty)]:
        return "found", ", ".join(dict.fromkeys(right)), false
    if not fault:
        return "nothing", "", false
    if observed := [(rule, text) for _, rule, text in found if faulty in text]:
        rule, text = observed[0]
        return "observed", f"{rule}: {short(text)}", false
    sent, usual = ([each.data for each in recorded(each, loss)] for each in (fault, ""))
    if sent == usual:
        return "not visible", "the beacons are those of a line without a fault", false
    neighbours = (NODES[FAULTY - 1], NODES[FAULTY + 1])
    asked = sum(each.asked for each in judge.ledger.entries() if each.node in neighbours)
    return "missed", f"too few occasions: its neighbours send {asked} requests", false


def faults(losses: Sequence[float]) -> tuple[list[str], bool]:
    """Return the section about findings, and whether none is false."""
    rows, wrong, count, visible = [], 0, {True: 0, False: 0}, 0
    for fault in ("", *FAULTS):
        for loss in losses:
            results = [outcome(fault, loss, links) for links in (LINKS, "")]
            wrong += sum(false for *_, false in results)
            visible += bool(fault) and results[0][0] != "not visible"
            for links, (result, _, _) in zip((True, False), results, strict=True):
                count[links] += result == "found"
            texts = [f"{result}: {why_}" if why_ else result for result, why_, _ in results]
            rows.append((fault or "none", f"{loss:.0%}", *texts))
    return [
        f"Found with the links: {count[True]} of {visible}; without: {count[False]} of {visible}. "
        f"False findings: {wrong}.",
        "",
        "*Observed* faults are reported as info: the recording does not prove that the node received the records.",
        "",
        table(("fault of the middle node", "loss", "links stated", "links inferred"), rows),
        "",
    ], not wrong


# -- page --------------------------------------------------------------------------------------------------------------


def stale_of(path: Path) -> tuple[list[tuple[str, int, int, int, int]], list[tuple[str, int, int, int, int]]]:
    """Return the stale states according to check, and to the page: node, variable, number, lag in values and in ms."""
    with open_capture(path) as reader:
        frames = list(reader)
    profile = guess(sample(iter(frames))[0]).best.profile.name
    judge, _ = judged(frames, profile)
    check = [(name(s.node), s.var_id, s.number, s.missed, round(s.age / 1e6)) for s in judge.ledger.stale()]
    read = gather(str(path), profile, None)
    page = [
        (read.nodes[s.node], s.variable, s.held, s.missed, round(s.age * 1000))
        for s in holding(read, time_of(read)).stale
    ]
    return sorted(check), sorted(page)


def pages(few: bool) -> tuple[list[str], bool]:
    """Return the section about page and check, and whether they agree."""
    rows, same = [], True
    with tempfile.TemporaryDirectory() as folder:
        for what, fault, loss in (
            ("a line without a fault, loss 30 %", "", 0.3),
            ("stuck", "stuck", 0.0),
            ("one deletion", "one deletion", 0.0),
            ("first container, loss 10 %", "first container", 0.1),
            ("captures/b_crud.mcap", "", 0.0),
        )[: 2 if few else 5]:
            path = ROOT / what
            if not path.exists():
                path = Path(folder) / "line.pcap"
                with create_capture(path) as writer:
                    for frame in recorded(fault, loss):
                        writer.write(frame)
            check, page = stale_of(path)
            same &= check == page
            rows.append((what, *map(told_of, (check, page)), "yes" if check == page else "**no**"))
    head = ("recording", "check: stale states, nodes, variables, longest lag", "page", "the same")
    return [table(head, rows), ""], same


def told_of(states: Sequence[tuple[str, int, int, int, int]]) -> str:
    """Return the numbers of some stale states."""
    if not states:
        return "0"
    nodes, variables = len({each[0] for each in states}), len({each[1] for each in states})
    return f"{len(states)}, {nodes}, {variables}, {max(each[4] for each in states) / 1000:.3f} s"


#: Recordings of the public C++ implementation, three nodes on a bus; four of them are in ``captures/``. The counts were
#: made without ``check`` and its ledger: states that a node keeps for three seconds after the producer left them, and
#: requests with an older number that a node with a newer one answers within four beacons.
_CPP = (
    ("a_bus3 (2.0)", "1011", "0", "no request", "nothing"),
    (
        "b_crud (2.0)", "563", "6, variables 10 and 11 at 00:02 and 00:03", "00:01 answers 30 of 234, 00:02 8 of 14",
        "found: CK_VD_ANSWER_UPDATE 00:01; observed: CK_NET_AGREES, the 6 states; CK_VD_ENDLESS",
    ),
    (
        "c_latejoin (2.0)", "270", "1, variable 1 at 00:02 for 4.5 s", "00:01 answers 12 of 40, 00:03 2 of 2",
        "found: CK_VD_TAKES_UPDATE 00:02; observed: CK_NET_AGREES, the state; inconclusive: CK_VD_ANSWER_UPDATE 00:01",
    ),
    (
        "a_bus3_v1.3.6 (1.3)", "1033", "0", "REQUEST-VARCREATES of variables that no node holds",
        "observed: the hazards H1, H2, CK_VD_ENDLESS",
    ),
    (
        "a_bus3_v1.2.0 (1.2)", "870", "0", "REQUEST-VARCREATES of variables that no node holds",
        "observed: the hazards H1, H2, CK_VD_ENDLESS",
    ),
)  # fmt: skip
_CPP_HEAD = ("recording", "beacons", "count: stale states", "count: requests answered", "check")


def cpp() -> list[str]:
    """Return the section about recordings of the C++ implementation."""
    return [
        "## Recordings of the C++ implementation",
        "",
        "Three nodes on a bus, counted without `check` and its ledger. A stale state is one that a node keeps for",
        "three seconds after the producer left it. Requests are those of numbers older than that of the node; it",
        "has four beacons to answer. `check` gives the same results with the bus stated and with inferred links.",
        "",
        table(_CPP_HEAD, _CPP),
        "",
        "No finding is false. The six states of b_crud are only observed, because nothing proves that the nodes",
        "received the updates; the missing answers in c_latejoin are inconclusive, because links that fail could",
        "explain them. Byte order and padding of releases 1.3 and 2.0 (DATA-01, DATA-02) and the test pattern of",
        "release 1.2 (SRP-FMT-01) fail; the profiles declare them.",
        "",
    ]


def main(arguments: Sequence[str] | None = None) -> int:
    """Write or print the page."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--short", action="store_true", help="fewer recordings; print the page")
    few = parser.parse_args(arguments).short
    asked, answers = questions(QUESTIONS[:2] if few else QUESTIONS)
    found, none_false = faults(LOSSES[:1] if few else LOSSES)
    side_by_side, same = pages(few)
    page = "\n".join(
        [
            "# Recordings with a ground truth",
            "",
            "Made by `python benchmarks/ground_truth.py`; do not edit.",
            "",
            "Lines of five simulated nodes, 00:00 to 00:04, with producers at both ends. The node in the middle,",
            "00:02, has one fault. The simulation reads the databases of all nodes each second.",
            "",
            "## Five questions for why",
            "",
            *asked,
            "## Findings of check",
            "",
            "Each line is judged with its links (`--hears 00:00-00:01-00:02-00:03-00:04`) and without.",
            "",
            *found,
            *cpp(),
            "## Page and check of the same recordings",
            "",
            *side_by_side,
        ]
    )
    if few:
        print(page)
    else:
        PAGE.write_text(page, encoding="utf-8")
    return 0 if answers and none_false and same else 1


if __name__ == "__main__":
    raise SystemExit(main())
