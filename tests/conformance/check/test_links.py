"""Links that the user tells or that reactions prove, and what is found with them: networks with ground truth."""

from __future__ import annotations

import csv
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.check import Judge
from dcp_conformance.check.base import name
from dcp_conformance.check.tables import write_tables
from dcp_conformance.check.topology import Topology, from_table, told
from dcp_conformance.check.why import Answer, why
from dcp_conformance.cli.links import links_of
from dcp_conformance.definitions.pics import Pics
from dcp_conformance.definitions.results import RunResult, Sut
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_selftest.recordings.lines import FAULTS, LINKS, NODES, PROFILE, recorded
from dcp_selftest.recordings.networks import SECOND, NetworkSituation, record
from dcp_tables.report.analysis import time_of
from dcp_tables.report.chapter import chapter
from dcp_tables.report.findings import read_findings
from dcp_tables.report.holding import holding
from dcp_tables.report.recorded import gather

from dcp_codec.capture import create_capture
from dcp_codec.codec import Codec

from ..air import Script

pytestmark = pytest.mark.part("suite")


def judged(fault: str = "", loss: float = 0.0, *, links: bool) -> tuple[Judge, RunResult]:
    judge = Judge(
        Codec(PROFILE), Pics(), recording="line", period_known=False, topology=told([LINKS]) if links else None
    )
    for frame in recorded(fault, loss):
        judge.feed(frame)
    return judge, judge.result()


def failures(run: RunResult) -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for case in run.cases:
        for check in case.checks:
            if check.verdict is Verdict.FAIL:
                found.setdefault(case.id, []).append(check.observed)
    return found


#: Fault -> loss of the links, the rules that find it with told links, and those that find it without.
EXPECTED = {
    "stuck": (0.0, {"CK_VD_TAKES_UPDATE"}, {"CK_VD_TAKES_UPDATE"}),
    # Without links the recording does not prove that the updates from the right were received.
    "one direction": (0.1, {"CK_VD_TAKES_UPDATE"}, set()),
    "one deletion": (0.0, {"CK_VD_TAKES_DELETE"}, {"CK_VD_TAKES_DELETE"}),
    "silent": (0.3, {"CK_VD_ANSWER_CREATE"}, {"CK_VD_ANSWER_CREATE"}),
    "first container": (
        0.1, {"CK_VD_TAKES_UPDATE", "CK_VD_TAKES_DELETE"}, {"CK_VD_TAKES_UPDATE", "CK_VD_TAKES_DELETE"},
    ),
    "no deletions": (0.1, {"CK_VD_TAKES_DELETE"}, {"CK_VD_TAKES_DELETE"}),
}  # fmt: skip


@pytest.mark.parametrize("fault", FAULTS)
def test_faults_in_a_line_are_found(fault):
    loss, with_links, without = EXPECTED[fault]
    for links, rules in ((True, with_links), (False, without)):
        found = failures(judged(fault, loss, links=links)[1])
        assert set(found) == rules, (links, found)
        assert all(text.startswith("02:00:00:00:00:02") for texts in found.values() for text in texts)


@pytest.mark.parametrize("loss", [0.0, 0.3])
def test_a_line_without_a_fault_has_no_finding(loss):
    for links in (True, False):
        assert failures(judged("", loss, links=links)[1]) == {}


@pytest.mark.parametrize("seed", [4, 5, 11])
def test_no_link_is_inferred_between_nodes_that_are_out_of_reach(seed):
    """Repetitions, own variables and timeouts look like reactions to records that a node cannot have received."""
    judge = Judge(Codec(PROFILE), Pics(), recording="line", period_known=False)
    for frame in record(NetworkSituation(shape="line", busy=2.0, deletes=0.0, seed=seed)):
        judge.feed(frame)
    judge.result()
    heard = {(a, b) for a in range(5) for b in range(5) if a != b and judge.hears(NODES[a], NODES[b])}
    assert all(abs(a - b) == 1 for a, b in heard), heard
    assert len(heard) >= 7


def test_results_state_where_the_links_come_from():
    _, run = judged("stuck", links=True)
    assert any("links: as told by --hears" in note for note in run.notes)
    pairs = {(each.listener[-2:], each.speaker[-2:]) for each in run.links if each.told}
    assert pairs == {(f"0{a}", f"0{b}") for a in range(5) for b in range(5) if abs(a - b) == 1}
    _, run = judged("stuck", links=False)
    assert "links: inferred from reactions" in run.notes
    assert not any(each.told for each in run.links)


def test_the_lag_of_a_stuck_node():
    judge, run = judged("stuck", links=False)
    longest = max(judge.ledger.stale(), key=lambda each: each.age)
    # The finding has the time at which the producer left the number.
    (agrees,) = [case for case in run.cases if case.id == "CK_NET_AGREES"]
    begin = judge.ledger.begin
    assert (longest.left.time - begin) / 1e9 in [pytest.approx(check.seconds, abs=1e-5) for check in agrees.checks]
    assert (longest.var_id, longest.number, longest.newest.number, longest.missed) == (1, 20, 50, 30)
    assert longest.node in NODES[2:]
    assert longest.deleted
    healthy, _ = judged(links=False)
    assert healthy.ledger.stale() == []
    assert 0 < max(each.age for each in healthy.ledger.entries(1)) < 1e9


def answer(judge: Judge, variable: int, node: int, seconds: float | None) -> Answer:
    return why(judge, variable, f"00:0{node}", seconds)


def frame_of(number: int, fault: str) -> bytes:
    """Return the sender of a frame."""
    (frame,) = [each for each in recorded(fault) if each.number == number]
    return frame.data[6:12]


def test_why_tells_the_way_of_a_value():
    judge, _ = judged("stuck", links=True)
    reply = answer(judge, 1, 4, 12.0)
    assert reply.holds.text == "holds 16 of variable 1, as its producer 02:00:00:00:00:00 does"
    # The value goes from node to node, and each cited frame is one of the node before.
    assert [step.node[-2:] for step in reply.came] == ["00", "01", "02", "03", "04"]
    for before, step in zip(reply.came, reply.came[1:], strict=False):
        assert f"after frame {before.frame} of {before.node} (the only frame with it before)" in step.text
        assert frame_of(before.frame, "stuck").hex(":") == before.node
    assert reply.stopped == ()


def test_times_begin_with_the_first_frame_also_if_it_has_no_record_of_a_variable():
    air = Script()
    air.say(1, report=air.report(1))
    air.time += 5 * SECOND
    air.say(1, air.create(7, 1))
    judge = Judge(air.codec, Pics(), recording="air")
    for frame in air.frames:
        judge.feed(frame)
    run = judge.result()
    seconds = (air.frames[1].time_ns - air.frames[0].time_ns) / 1e9
    assert why(judge, 7, "01", None).holds.seconds == pytest.approx(seconds, abs=1e-3)
    assert run.holdings["begin_ns"] == air.frames[0].time_ns


def test_why_tells_where_a_value_stops():
    judge, _ = judged("stuck", links=True)
    reply = answer(judge, 1, 4, 30.0)
    assert reply.holds.text.startswith(
        "holds 20 of variable 1; its producer 02:00:00:00:00:00 has 42, 22 numbers later"
    )
    first, second, *_ = reply.stopped
    assert (first.node[-2:], first.text.split(";")[0]) == ("01", "holds 42 of variable 1")
    assert (second.node[-2:], second.text.split(";")[0]) == ("02", "holds 20 of variable 1")
    assert "requests the update" in second.text
    assert "has received UPDATES with 21 in frame" in reply.stopped[2].text
    assert [step.node[-2:] for step in reply.stopped if step.text.startswith("holds")] == ["01", "02", "03", "04"]


def test_why_reports_a_deletion_that_was_received():
    judge, _ = judged("one deletion", links=False)
    reply = answer(judge, 14, 2, None)
    assert reply.holds.text.startswith("holds 0 of variable 14; its producer 02:00:00:00:00:00 has deleted it")
    (proof,) = [step for step in reply.stopped if "has received" in step.text]
    assert "DELETE-VARIABLES" in proof.text
    assert "CREATE-VARIABLES of variable 43 proves the reception" in proof.text


def test_why_refuses_what_it_does_not_know():
    judge, _ = judged("stuck", links=True)
    with pytest.raises(UsageError, match="--node 07: is not in the recording"):
        why(judge, 1, "07", None)
    with pytest.raises(UsageError, match="--variable 99: no record"):
        why(judge, 99, "00:02", None)


def test_tables_of_the_ledger(tmp_path):
    judge, run = judged("stuck", links=True)
    write_tables(judge, run, tmp_path)
    with (tmp_path / "holdings.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    behind = {
        (row["node"][-2:], row["varId"], row["seqno"], row["lagValues"]) for row in rows if row["lagValues"] == "30"
    }
    assert behind == {(node, "1", "20", "30") for node in ("02", "03", "04")}
    with (tmp_path / "links.csv").open(encoding="utf-8") as file:
        assert {row["told"] for row in csv.DictReader(file)} == {"True"}
    with (tmp_path / "events.csv").open(encoding="utf-8") as file:
        assert [row["rule"] for row in csv.DictReader(file) if row["verdict"] == "fail"] == ["CK_VD_TAKES_UPDATE"]


def test_the_page_of_the_recording_says_the_same(tmp_path):
    """Findings of check are on the page; its sentences and tiles agree with them."""
    path = tmp_path / "line.pcap"
    for fault in ("", "stuck"):
        with create_capture(path) as writer:
            for frame in recorded(fault):
                writer.write(frame)
        judge, run = judged(fault, links=True)
        run = msgspec.structs.replace(run, sut=Sut(link="recording line.pcap"))
        (tmp_path / "results.json").write_bytes(msgspec.json.encode(run))
        recorded_ = gather(str(path), PROFILE, None)
        drawn = chapter(recorded_, 1, read_findings(tmp_path / "results.json"))
        section = next(each for each in drawn.sections if each.id.startswith("findings"))
        shown = [row[1].text for each in section.tables for row in each.rows if row[0].text == "fail"]
        assert shown == [rule for rule, texts in failures(run).items() for _ in texts]
        tiles = {name: text for text, name, _ in drawn.tiles}
        held = next(each for each in drawn.sections if each.id.startswith("holding"))
        late = judge.ledger.stale()
        on_page = holding(recorded_, time_of(recorded_)).stale
        assert sorted(
            (recorded_.nodes[each.node], each.variable, each.held, each.missed) for each in on_page
        ) == sorted((name(each.node), each.var_id, each.number, each.missed) for each in late)
        assert tiles["were stale"] == (f"≠ {len({(each.node, each.var_id) for each in late})}" if late else "0")
        assert bool(late) == held.words[0].startswith("≠ Nodes with stale values") == bool(shown)


def test_links_of_options_and_files(tmp_path):
    a, b, c = NODES[:3]
    line = told(["00:00-00:01-00:02"])
    assert (line.hears(a, b), line.hears(b, c), line.hears(a, c), line.hears(NODES[4], a)) == (True, True, False, None)
    one = told(["00:02=00:01,00:00"])
    assert (one.hears(c, a), one.hears(a, c)) == (True, None)
    for text in ("", "a=", "=b", "a-", "a"):
        with pytest.raises(UsageError, match="expected A=B,C"):
            told([text])
    path = tmp_path / "links.toml"
    path.write_text('[hears]\n"00:01" = ["00:00"]\n')
    assert links_of((), path).hears(b, a) is True
    assert links_of((), None) is None
    with pytest.raises(UsageError, match="not both"):
        links_of(("a-b",), path)
    with pytest.raises(UsageError, match=r"a table \[hears\]"):
        from_table(path, {})
    assert Topology({"00:01": [], "9": []}, "x").unknown(NODES) == ["9"]


def test_links_of_a_scenario():
    scenario = Path(__file__).resolve().parents[3] / "examples" / "line.toml"
    links = links_of((), scenario)
    assert links is not None
    assert links.hears(NODES[1], NODES[0]) is True
    assert links.hears(NODES[2], NODES[0]) is False
