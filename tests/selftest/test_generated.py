"""Generated mutants: random changes of the node's source, and which of them the suite notices."""

from __future__ import annotations

import ast
import multiprocessing
import subprocess
import sys
from concurrent.futures import ProcessPoolExecutor

import msgspec
import pytest
from dcp_conformance.definitions.case import DECLARED, SANITY
from dcp_conformance.errors import ConformanceError
from dcp_selftest.generated import campaign
from dcp_selftest.generated.campaign import GeneratedResult, Trial, draw, run
from dcp_selftest.generated.ledger import CLASSES, entries, ledger
from dcp_selftest.generated.reach import Reach
from dcp_selftest.generated.reports import _SHOWING, reports_of
from dcp_selftest.generated.sites import Site, _candidates, changes, cited, mutated, sites
from dcp_selftest.generated.table import section
from dcp_selftest.generated.trial import MODEL, NODES, Outcome, Step, _in_order, cases, measure, steps, try_site

from ..conformance.command import Command


def site(text: str, operator: str) -> Site:
    """The only change of this kind whose text has these words."""
    [found] = [each for each in sites() if text in str(each) and each.operator == operator]
    return found


@pytest.mark.part("suite")
def test_every_change_is_one_and_compiles():
    chosen = draw(150, 7)
    for each in chosen:
        tree = mutated(each)
        compile(tree, each.module, "exec")
        assert ast.dump(tree) != ast.dump(ast.parse(ast.unparse(_original(each))))


def _original(each: Site) -> ast.Module:
    from dcp_selftest.generated.sites import _source

    return ast.parse(_source(each.module))


def test_keys_distinguish_changes():
    assert len({each.key for each in sites()}) == len(sites()) > 1000


SOURCE = """
class Receiver:
    def handle(self, octets):
        if not octets:
            self._drop("empty")
            return
        self._emit(Dropped("bp", "odd", len(octets) + 1))
        self._counters.count("octets", len(octets) - 1)
        self.fault = Fault("odd", "BP-RX-16", 1 + 2)
        if len(octets) > 9:
            raise ValueError("octets")
        self.first = config.selected_readings.first_seqno == "first"
        self.last = readings.first_seqno == "first"
        self._emit(Received(octets, 2))

    def _drop(self, reason):
        "Report it."
        if reason is not None:
            self._emit(Dropped("bp", reason, 1 + 1))

    def snapshot(self):
        return {"a": _plain(1 < 2), "b": _shared(3)}

def _plain(value):
    return value + 1

def _shared(value):
    return value + 1

def compute():
    return _shared(4)
"""


def test_code_that_only_reports_or_displays_is_not_changed():
    tree = ast.parse(SOURCE)
    assert reports_of(tree).functions - _SHOWING == {"_drop", "_plain"}
    changed = {(function, ast.unparse(node)) for function, _, node in _candidates(tree) if list(changes(node))}
    names = {function for function, _ in changed}
    assert names == {"Receiver.handle", "_shared", "compute"}
    assert ("Receiver.handle", "self._emit(Received(octets, 2))") in changed
    assert ("Receiver.handle", "self.fault = Fault('odd', 'BP-RX-16', 1 + 2)") in changed
    texts = {text for _, text in changed}
    assert texts.isdisjoint({"self._drop('empty')", "len(octets) - 1", "1 + 2", "len(octets) > 9"})
    assert not any(
        "Dropped" in text or text.startswith(("config.selected", "readings.", "if len(octets) > 9")) for text in texts
    )


def test_the_same_seed_draws_the_same():
    assert draw(50, 3) == draw(50, 3)
    assert draw(50, 3) != draw(50, 4)
    assert {each.module for each in draw(40, 1, patterns=["vardis/receive.py"])} == {"vardis.receive"}


def test_the_ledger_is_well_formed_and_about_existing_code():
    known = {each.key for each in sites()}
    named = [change.split()[0] for entry in entries() for change in entry.changes]
    assert len(named) == len(set(named))
    assert {entry.kind for entry in entries()} <= set(CLASSES)
    gone = [key for key in named if key not in known]
    assert not gone, "the code of these changes has changed: take them out of data/invisible-changes/"
    assert len(ledger()) == len(named)


def test_faults_are_noticed_and_others_survive():
    """One fault breaks a rule, one ends the node at its start, and one cannot be observed from outside."""
    wrong = site("Database.store: dropped assignment: entry.value = value", "dropped assignment")
    broken = site("BeaconingProtocol.__init__: dropped assignment: self._seqno =", "dropped assignment")
    result = run([wrong, broken], jobs=2)
    fates = {trial.site.key: trial for trial in result.trials}
    assert fates[wrong.key].outcome.fate == "killed"
    assert "TC_" in fates[wrong.key].outcome.by
    assert fates[broken.key].killed
    assert result.score == 1.0
    assert result.survivors == ()


def test_declarations_of_a_profile_kill_no_mutant():
    """TC_DCP_PROF_BV_01 fails on cpp-2.0 whatever the node does: once every change counted as killed for that."""
    reported = site("Vardis._scrub: dropped call: self._core.changed('deleted', entry)", "dropped call")
    wanted = ("TC_DCP_SANITY_BV_01", DECLARED, "TC_VD_PC_BI_01")
    few = tuple(number for number, case in enumerate(cases()) if case.id in wanted)
    [answer] = _in_new_processes(try_site, (reported, (Step("cpp-2.0", few),)))
    assert answer.fate == "survived"


def test_cases_of_the_model_follow_all_hand_written_ones():
    wrong = site("Database.store: dropped assignment: entry.value = value", "dropped assignment")
    model = [number for number, case in enumerate(cases()) if case.id.startswith(MODEL)]
    by_hand = [number for number, case in enumerate(cases()) if case.id == "TC_VD_UPD_BV_01"]
    [both] = _in_new_processes(try_site, (wrong, (Step("dcp-2.0", (*model, *by_hand)),)))
    [alone] = _in_new_processes(try_site, (wrong, (Step("dcp-2.0", tuple(model)),)))
    assert (both.fate, both.by_model) == ("killed", False)
    assert (alone.fate, alone.by_model) == ("killed", True)


def test_a_trial_runs_the_cases_that_execute_the_changed_lines():
    one = site("Database.store: dropped assignment: entry.value = value", "dropped assignment")
    lines = {one.module: {one.first: (3, 5), one.first + 1: (4,)}}
    stores = Reach("dcp-2.0", lines, {})
    elsewhere = Reach("dcp-1.0", {one.module: {one.first + 1: (4,)}}, {})
    configures = Reach("dcp-1.3", {}, {one.module: (one.first,)})
    assert steps(one, (stores, elsewhere, configures)) == (Step("dcp-2.0", (3, 5)), Step("dcp-1.3", None))
    assert steps(one, (elsewhere,)) == ()
    assert [step.cases for step in steps(one)] == [None] * len(NODES)
    assert stores.cases(one._replace(first=0, last=0)) is None


def test_lines_executed_by_cases_are_measured():
    number = {case.id: number for number, case in enumerate(cases())}
    few = [number[SANITY], number["TC_VD_UPD_BV_01"]]
    [reach] = _in_new_processes(measure, ("dcp-2.0", few))
    store = site("Database.store: dropped assignment: entry.value = value", "dropped assignment")
    assert reach.cases(store) == {number["TC_VD_UPD_BV_01"]}
    # The code that builds tables and configurations is executed before the first case.
    assert reach.cases(site("_known: other return value", "other return value")) is None
    assert reach.cases(site("_terminator: other return value", "other return value")) is None


def test_cases_that_name_a_requirement_cited_near_the_change_come_first():
    stored = site("Database.store: dropped assignment: entry.t_stamp = wall", "dropped assignment")
    assert "VD-DB-03" in cited(stored)
    first = _in_order(stored, None)[0]
    assert set(cited(stored)).intersection(first.requirements)


def test_a_fixed_draw_is_killed_or_in_the_ledger():
    result = run(draw(12, 20), jobs=2)
    assert len(result.judged) >= 6
    assert [str(trial.site) for trial in result.survivors] == []


def _in_new_processes(work, *calls):
    """Return the results of ``work`` in processes that have not imported the node."""
    context = multiprocessing.get_context("forkserver")
    with ProcessPoolExecutor(1, mp_context=context) as pool:
        return [pool.submit(work, *arguments).result() for arguments in calls]


def test_an_unchanged_node_that_fails_ends_the_run(monkeypatch):
    """Otherwise every change would count as killed, as it once did beside an unfinished edit."""
    monkeypatch.setattr(campaign, "ask", lambda *_: (msgspec.json.encode(Outcome("", "broken", "SyntaxError: x")), ""))
    with pytest.raises(ConformanceError, match="does not work without a change: SyntaxError: x"):
        run(sites()[:1])


def test_survivors_excused_by_the_ledger_do_not_count():
    one = sites()[0]
    excused = Trial(one, Outcome(one.key, "survived"), "counter: only dcp-node shows it")
    wrong = Trial(one, Outcome(one.key, "killed"), "counter: only dcp-node shows it")
    survivor = Trial(one, Outcome(one.key, "noticed"))
    result = GeneratedResult(trials=(excused, wrong, survivor))
    assert result.judged == (survivor,)
    assert result.survivors == (survivor,)
    assert result.misplaced == (wrong,)
    assert result.score == 0.0


def test_a_trial_refuses_a_process_that_has_imported_the_node():
    code = "import dcp_stack.bp.entity\nfrom dcp_selftest.generated.trial import try_site\ntry_site(None)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert "has been imported already" in done.stderr


class TestCommand:
    def test_the_list(self, dcp_selftest: Command):
        done = dcp_selftest("generated", "3", "--seed", "5", "--list")
        assert done.status == 0
        assert len(done.out.splitlines()) == 3
        assert all("dcp_stack/" in line for line in done.out.splitlines())

    def test_several_draws_make_a_section_of_the_document(self):
        one, two = (
            GeneratedResult(seed=seed, drawn=2, trials=trials)
            for seed, trials in (
                (
                    8,
                    (
                        Trial(sites()[0], Outcome(sites()[0].key, "killed")),
                        Trial(sites()[2], Outcome(sites()[2].key, "killed", by_model=True)),
                        Trial(sites()[1], Outcome("", "survived")),
                    ),
                ),
                (9, (Trial(sites()[0], Outcome(sites()[0].key, "excused"), "counter: only dcp-node shows it"),)),
            )
        )
        text = section([one, two])
        assert "`dcp-selftest generated 2 --seed 8 --seed 9 --document docs/selftest.md`" in text
        assert "| 8 | 2 | 0 | 3 | 2 | 1 | 1 | 33.3% | 66.7% |" in text
        assert "| 9 | 2 | 1 | 0 | 0 | 0 | 0 | 100.0% | 100.0% |" in text
        assert f"| `{sites()[1].module}.{sites()[1].function}` | {sites()[1].operator}: " in text
        assert (
            f"The ledger holds {sum(len(entry.changes) for entry in entries()):,} of {len(sites()):,} changes" in text
        )

    def test_draws_with_several_seeds_are_listed_once(self, dcp_selftest: Command):
        done = dcp_selftest("generated", "3", "--seed", "5", "--seed", "5", "--list")
        assert len(done.out.splitlines()) == 3

    def test_usage(self, dcp_selftest: Command):
        done = dcp_selftest("generated", "3", "no such text")
        assert done.status == 2
        assert "no change of the node's source contains" in done.err

    def test_a_survivor_is_shown_with_file_line_and_change(self, dcp_selftest: Command, tmp_path):
        wrong = site("Database.store: dropped assignment: entry.value = value", "dropped assignment")
        done = dcp_selftest("generated", "1", wrong.key, "-v", "--report-dir", tmp_path)
        assert done.status == 0, done.out
        assert "dcp_stack/vardis/database.py:" in done.out
        assert "1 of 1 random changes killed (100.0%)" in done.out
        assert (tmp_path / "generated.json").exists()


def test_a_node_that_sends_without_end_at_one_time_is_dead():
    """In virtual time the tester would listen for ever; on a link time passes."""
    from dcp_conformance.reference.inprocess import InProcess, reference_config
    from dcp_selftest.mutants import all_mutants

    from ..conformance.rig import codec_of

    sut = InProcess(reference_config(codec_of("dcp-2.0")), make=all_mutants()["M-BP-TX-01-bursts"].make)
    assert sut.upper_tester().call("RTDB-Create", {"varId": 1, "repCnt": 3, "descr": "d", "value": "01"}).ok
    lower, frames = sut.lower_tester(), 0
    while lower.receive(60_000_000_000) is not None:
        frames += 1
        assert frames < 5_000
    assert sut.died == "" or "timeouts were handled" in sut.died


def test_a_node_that_raises_when_it_is_asked_for_its_next_timer_is_dead():
    """The tester used to stumble instead, and a fault of the node counted as one of the tester."""
    from dcp_conformance.reference.inprocess import InProcess, reference_config

    from dcp_stack.node import Node

    from ..conformance.rig import codec_of

    class Raises(Node):
        def poll_timeout(self):
            raise TypeError("no timer")

    sut = InProcess(
        reference_config(codec_of("dcp-2.0")),
        make=lambda *args: Raises(args[0], rng=args[1], now=args[2], wall=args[3]),
    )
    assert sut.lower_tester().receive(10_000_000_000) is None
    assert sut.died == "TypeError: no timer"
