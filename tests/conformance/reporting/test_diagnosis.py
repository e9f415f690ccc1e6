"""The diagnosis names the faults that explain a set of failed cases."""

from __future__ import annotations

import msgspec
import pytest
from dcp_conformance.definitions.case import DECLARED, DENIED, all_cases
from dcp_conformance.definitions.results import CaseResult, Check, Mark, RunResult
from dcp_conformance.definitions.survival import SURVIVAL
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.diagnosis import Dictionary, Fault, explain, load
from dcp_conformance.diagnosis.dictionary import decode, encode
from dcp_conformance.diagnosis.observation import digest
from dcp_conformance.errors import UpperTesterError
from dcp_conformance.reporting.exports import summary_markdown
from dcp_conformance.reporting.overview import certainty, diagnosed, headline, sentence
from dcp_selftest.diagnosis import measuring
from dcp_selftest.diagnosis.dictionary_making import signature
from dcp_selftest.diagnosis.measuring import draw, outcome
from dcp_selftest.diagnosis.unknown import in_process, selections, summary
from dcp_selftest.generated.isolation import process_context
from dcp_selftest.generated.sites import sites
from dcp_selftest.mutants import all_mutants
from dcp_selftest.mutants.combination import combined
from hypothesis import given
from hypothesis import strategies as st


def fault(name: str, *fails: str, undecided: tuple[str, ...] = ()) -> Fault:
    """A fault with which each failed case shows what it shows in :func:`results`."""
    made = Fault(
        id=name, requirements=("VD-RU-03",), what=f"does {name}", fails=frozenset(fails), undecided=frozenset(undecided)
    )
    return seen(made, dict.fromkeys(fails, "that"))


def results(fails: str = "", passes: str = "", undecided: str = "") -> list[CaseResult]:
    verdicts = [(Verdict.FAIL, fails), (Verdict.PASS, passes), (Verdict.INCONCLUSIVE, undecided)]
    return [
        CaseResult(
            id=name,
            purpose=f"Purpose of {name}",
            section="",
            kind="BV",
            requirements=("VD-RU-03",),
            verdict=verdict,
            rerun=f"again {name}",
            checks=(Check(verdict, ("VD-RU-03",), "this", "that", (Mark(3),)),),
        )
        for verdict, names in verdicts
        for name in names
    ]


def named(diagnosis) -> list[str]:
    return [each.fault for each in diagnosis.faults]


def test_one_fault_explains_all_its_cases() -> None:
    found = explain(results("abc", "defg"), Dictionary((fault("X", "a", "b", "c"), fault("Y", "a", "d", "e"))))
    assert named(found) == ["X"]
    (only,) = found.faults
    assert only.explains == only.alone == ("a", "b", "c")
    assert (only.share, only.expected, only.missing) == (1.0, 3, ())
    # Not "a", which other faults make fail as well.
    assert (only.case, only.mark, only.rerun) == ("b", Mark(3), "again b")
    assert found.unexplained == ()


def test_a_fault_whose_cases_are_explained_by_others_is_removed() -> None:
    # Z shares cases with both and is the best single one; X and Y explain everything, and Z nothing more.
    known = Dictionary((fault("X", *"abcd"), fault("Y", *"efgh"), fault("Z", *"bcdefgz")))
    assert named(explain(results("abcdefgh", "z"), known)) == ["X", "Y"]


def test_a_passing_case_is_evidence_against_a_fault() -> None:
    known = Dictionary((fault("X", "a", "b", "c", "d"), fault("Y", "a")))
    assert named(explain(results("a", "bcd"), known)) == ["Y"]


def test_a_fault_that_leaves_nearly_all_cases_undecided_is_not_named_if_these_pass() -> None:
    """It explained every failure a little, and nothing spoke against it."""
    every = "abcdefghijklmnopqrstuvwxyz"
    silent = fault("silent", "a", undecided=tuple(every[1:]))
    known = Dictionary((silent, fault("X", *"abcdef")))
    found = explain(results("abcdefghijk", every[11:]), known)
    assert named(found) == ["X"]
    assert found.unexplained == tuple("ghijk")
    assert named(explain(results("a", "", every[1:]), Dictionary((silent,)))) == ["silent"]


def test_inconclusive_cases_are_not_evidence() -> None:
    known = Dictionary((fault("X", "a", "b", "c", "d"),))
    (found,) = explain(results("a", undecided="bcd"), known).faults
    assert found.expected == 1
    assert found.missing == ()


def test_unexplained_cases_are_listed() -> None:
    found = explain(results("abq", "c"), Dictionary((fault("X", "a", "b"),)))
    assert named(found) == ["X"]
    assert found.unexplained == ("q",)
    assert found.failed == 3


def test_declared_deviations_need_no_fault() -> None:
    declared = [msgspec.structs.replace(each, id=name) for each in results("a") for name in (DECLARED, DENIED)]
    found = explain([*results("a", "b"), *declared], Dictionary((fault("X", "a"),)))
    assert (named(found), found.failed, found.unexplained) == (["X"], 1, ())


def test_the_summary_shows_observations_of_unexplained_cases() -> None:
    cases = tuple(results("ab", "c"))
    run = RunResult(cases=cases, diagnosis=explain(cases, Dictionary((fault("X", "a"),))))
    assert "Unexplained:\n\n* b: Purpose of b. Expected this; observed that.\n" in summary_markdown(run)


def test_faults_with_the_same_consequences_are_alternatives() -> None:
    found = explain(results("ab"), Dictionary((fault("X", "a", "b"), fault("Y", "a", "b"), fault("Z", "b"))))
    assert len(found.faults) == 1
    assert len(found.faults[0].alternatives) == 1
    assert {found.faults[0].what, *found.faults[0].alternatives} == {"does X", "does Y"}


def seen(fault: Fault, observed: dict[str, str]) -> Fault:
    """The fault, with what is observed in its cases."""
    texts = {
        case: digest(Check(Verdict.FAIL, ("VD-RU-03",), "this", text, (Mark(9),))) for case, text in observed.items()
    }
    return msgspec.structs.replace(fault, observed=frozenset(texts.items()))


#: An observation that is not that of :func:`results`.
OTHER = "VARDIS-STATUS-INACTIVE"


def test_the_wording_of_a_check_and_its_numbers_do_not_change_its_digest() -> None:
    check = Check(Verdict.FAIL, ("VD-RU-03",), "3 beacons", "RTDB-Read answers VARDIS-STATUS-OK after 7 ms", (Mark(3),))
    worded = msgspec.structs.replace(check, expected="beacons: 3", observed="VARDIS-STATUS-OK", frames=(Mark(9),))
    assert digest(check) == digest(worded)
    for changed in (
        msgspec.structs.replace(check, observed=OTHER),
        msgspec.structs.replace(check, requirements=("VD-RU-04",)),
        msgspec.structs.replace(check, frames=()),
        msgspec.structs.replace(check, shown=True),
    ):
        assert digest(check) != digest(changed)


def test_a_case_without_a_recorded_observation_does_not_count_as_alike() -> None:
    """A wide fault without observations once explained every selection of cases."""
    wide = msgspec.structs.replace(fault("wide", *"abcdefghij"), observed=frozenset())
    found = explain(results("abc"), Dictionary((wide,))).faults
    assert all((each.alike, each.likely, each.certain) == (0, False, False) for each in found)
    assert named(explain(results("abc"), Dictionary((wide, fault("X", *"abc"))))) == ["X"]


def test_a_selection_of_cases_leaves_a_statement_probable() -> None:
    """At least half of the cases that a fault makes fail must have been run."""
    known = Dictionary((fault("X", *"abcdefg"),))
    (found,) = explain(results("abc"), known).faults
    assert (found.expected, found.signature, found.likely, found.certain) == (3, 7, True, False)
    (found,) = explain(results("abcd"), known).faults
    assert found.certain


def test_one_case_with_another_observation_does_not_show_a_fault() -> None:
    """Diagnosis once reported as a fact: "registers without a name", of an implementation that has another name."""
    assert named(explain(results("a", "bc"), Dictionary((seen(fault("X", "a"), {"a": OTHER}),)))) == []
    found = explain(results("a", "bc"), Dictionary((seen(fault("X", "a"), {"a": "that"}),)))
    assert named(found) == ["X"]
    assert sentence(found.faults[0]) == "a fails, as it does for a node that does X"


def test_the_observation_decides_between_faults_with_the_same_cases() -> None:
    known = Dictionary((seen(fault("X", *"abc"), dict.fromkeys("abc", OTHER)), fault("Y", *"abc")))
    (found,) = explain(results("abc"), known).faults
    assert (found.fault, found.alike, found.alternatives) == ("Y", 3, ())
    assert found.certain
    assert sentence(found) == "the implementation violates VD-RU-03: it probably does Y"


def test_a_statement_is_only_probable_if_an_observation_differs_or_an_expected_failure_lacks() -> None:
    known = Dictionary((seen(fault("X", "a", "b", "c"), {"a": "that", "b": "that", "c": OTHER}),))
    (found,) = explain(results("abc", "xyz"), known).faults
    assert (found.alike, found.likely, found.certain) == (2, True, False)
    assert sentence(found) == "the implementation probably does X"
    assert certainty(found).endswith("; what was observed is the same in 2 of 3 cases")
    (found,) = explain(results("ab", "c"), known).faults
    assert (found.alike, found.likely) == (2, False)
    assert sentence(found) == "2 cases fail that also fail for a node that does X, but 1 that should fail passed"
    assert "of 3 decided cases that fail for a node with only this fault, 2 failed here" in certainty(found)
    (found,) = explain(results("abcd", "xyz"), Dictionary((fault("X", *"abc"),))).faults
    assert sentence(found) == "the implementation probably does X"
    (found,) = explain(results("abc", "xyz"), Dictionary((fault("X", *"abc"),))).faults
    assert sentence(found) == "the implementation violates VD-RU-03: it probably does X"


def test_cases_with_other_observations_do_not_describe_the_implementation() -> None:
    known = Dictionary((seen(fault("X", "a", "b", "c"), dict.fromkeys("abc", OTHER)),))
    (found,) = explain(results("abc", "xyz"), known).faults
    assert (found.alike, found.likely, found.certain) == (0, False, False)
    assert sentence(found) == "3 cases fail that also fail for a node that does X, but the observation differs"
    run = RunResult(cases=tuple(results("abc", "xyz")), diagnosis=explain(results("abc", "xyz"), known))
    text = summary_markdown(run)
    assert "1. 3 cases fail that also fail for a node that does X, but the observation differs" in text
    assert "   Expected this; observed that." in text


#: A node with one of these does not answer any more, which is all that its failed cases show.
SILENT = {
    "M-BP-TX-04-hangs",
    "M-BP-MGT-05-no-resume",
    "M-BP-MGT-05-receives-only",
    "M-BP-RX-16-mute",
    "M-VD-ROB-01-mute",
    "M-VD-RUN-02-checks-after-the-old-period",
    "M-VD-RUN-02-no-check-after",
}


def test_the_observations_of_a_fault_are_those_of_its_failed_cases() -> None:
    for each in load().faults:
        assert {case for case, _ in each.observed} <= each.fails
        if each.fails and not each.crashes and each.id not in SILENT:
            assert each.observed, f"run: dcp-selftest dictionary FILE {each.id}"


def test_nothing_failed() -> None:
    found = explain(results("", "abc"), load())
    assert found.faults == ()
    assert found.failed == 0


names = st.sampled_from("abcdefghij")
faults = st.builds(
    lambda name, fails, undecided, texts: seen(
        fault(name, *fails, undecided=tuple(undecided - fails)), {case: texts[case] for case in fails & texts.keys()}
    ),
    st.text("XYZ", min_size=1, max_size=4),
    st.frozensets(names),
    st.frozensets(names),
    st.dictionaries(names, st.sampled_from(["that", OTHER])),
)


@given(st.lists(faults, unique_by=lambda each: each.id), st.text("abcdefghij"), st.text("abcdefghij"))
def test_every_failed_case_is_explained_or_listed_as_unexplained(known: list[Fault], fails: str, passes: str) -> None:
    found = explain(results("".join(set(fails)), "".join(set(passes) - set(fails))), Dictionary(tuple(known)))
    explained = {case for each in found.faults for case in each.explains}
    assert explained.isdisjoint(found.unexplained)
    assert explained | set(found.unexplained) == set(fails)
    for each in found.faults:
        assert set(each.alone) <= set(each.explains)
        assert set(each.missing) <= set(passes)
        assert len(each.missing) * 2 <= each.expected


@given(st.lists(faults, unique_by=lambda each: each.id))
def test_the_dictionary_survives_a_round_trip(known: list[Fault]) -> None:
    octets = encode(Dictionary(tuple(known)))
    assert set(decode(octets).faults) == set(known)
    assert encode(decode(octets)) == octets


def test_the_dictionary_has_all_mutants_and_known_cases_only() -> None:
    known, every = {fault.id: fault for fault in load().faults}, all_mutants()
    assert known.keys() == every.keys(), "run: dcp-selftest dictionary FILE"
    cases = all_cases().keys()
    for name, each in known.items():
        assert each.fails <= cases
        assert each.what == every[name].what, f"run: dcp-selftest dictionary FILE {name}"
        assert each.requirements == every[name].requirements


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    "mutant",
    [
        "M-BP-HDR-03-reversed",
        "M-BP-TX-01-slow",
        "M-SRP-SEQ-01-eight-bits",
        "M-SRP-NT-03-own",
        "M-VD-RU-01-ignored",
    ],
)
def test_the_signatures_of_the_dictionary_are_those_of_the_present_cases(mutant: str) -> None:
    then = next(each for each in load().faults if each.id == mutant)
    now = signature(all_mutants()[mutant]).fault
    changed = (now.fails ^ then.fails) | (now.undecided ^ then.undecided)
    assert len(changed) <= max(3, 0.1 * len(now.fails | now.undecided)), (
        "the cases have changed: run `dcp-selftest dictionary "
        "conformance/dcp_conformance/data/fault-dictionary.json` (about 20 minutes of processor time), then "
        "`dcp-selftest smoke-plan conformance/dcp_conformance/data/case-times.json`"
    )


def test_faults_left_out_of_the_dictionary_are_counted_once() -> None:
    """Without its own entry a fault is explained by similar ones, or not at all."""
    found = measuring.hold_back(3, 7, Dictionary((fault("X", "a", "b"), fault("Y", "a", "b"), fault("Z", "c", "d"))))
    assert (found.faults, found.same, found.other, found.none) == (3, 2, 0, 1)
    assert found.true == found.statements == 0


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    "group",
    [
        ("M-BP-QM-01-drops-head", "M-VD-RU-03-equal-answered"),
        ("M-VD-CMP-06-one-more", "M-SRP-RX-03-first-stays"),
    ],
)
def test_two_faults_in_one_node_are_both_named(group: tuple[str, str]) -> None:
    assert set(group) <= all_mutants().keys()
    found = outcome(group, load())
    assert set(found.found) == set(group)
    assert found.false == ()


def test_a_node_that_does_not_start_shows_none_of_its_faults(monkeypatch: pytest.MonkeyPatch) -> None:
    def closes(*_: object) -> None:
        raise UpperTesterError("UT-Hello: the node has closed the connection")

    monkeypatch.setattr(measuring, "diagnose", closes)
    group = ("M-VD-RU-03-equal-answered", "M-BP-HDR-01-two")
    found = outcome(group, load())
    assert (found.hidden, found.named) == (group, ())


def test_draws_can_be_combined_and_repeated() -> None:
    groups = draw(5, 3, 7)
    assert groups == draw(5, 3, 7)
    for group in groups:
        assert len(set(group)) == 3
        combined([all_mutants()[name] for name in group])


def test_a_diagnosis_is_part_of_the_results() -> None:
    found = explain(results("abc"), Dictionary((fault("X", "a", "b", "c"),)))
    assert msgspec.json.decode(msgspec.json.encode(found), type=type(found)) == found


# -- cases that the implementation does not survive --------------------------------------------------------------------


def ending(names: str, death: str = "died: it ended with signal SIGABRT", *, also: str = "") -> list[CaseResult]:
    """Failed cases that the implementation did not survive; in those of ``also`` something else failed as well."""
    survival = Check(
        Verdict.FAIL, ("VD-RU-03",), f"{SURVIVAL} a frame", "it is not running after this case", (Mark(4),)
    )
    return [
        msgspec.structs.replace(
            case, death=death, killed=True, checks=(*(case.checks if case.id in also else ()), survival)
        )
        for case in results(names)
    ]


def crashing(name: str, *fails: str) -> Fault:
    return msgspec.structs.replace(fault(name, *fails), what=f"crashes on {name}")


def test_a_case_that_only_ended_the_implementation_shows_no_other_fault() -> None:
    run = [*results("ab", "xyz"), *ending("cdef")]
    found = explain(run, Dictionary((fault("X", "a", "b"), fault("Y", "c", "d", "e", "f"))))
    assert named(found) == ["X"]
    assert (found.unexplained, found.ended) == ((), ("c", "d", "e", "f"))
    assert diagnosed(RunResult(cases=tuple(run), diagnosis=found)) == (
        "1 probable fault explains 2 of 6 cases that failed; in 4 the implementation only ended or stopped answering"
    )


def test_a_fault_that_crashes_a_node_explains_only_cases_that_the_implementation_did_not_survive() -> None:
    known = Dictionary((crashing("X", "a", "b", "c"),))
    assert named(explain(results("abc", "xyz"), known)) == []
    found = explain([*ending("abc", also="c"), *results("", "xyz")], known)
    assert named(found) == ["X"]
    assert found.faults[0].explains == ("a", "b", "c")
    assert found.faults[0].check is not None
    assert found.faults[0].check.expected.startswith(SURVIVAL)


@pytest.mark.parametrize(
    ("deaths", "word"),
    [
        (("died: it ended with signal SIGSEGV",) * 2, "crashes"),
        (("died: it ended with exit status 3; its output: fatal",) * 2, "ends"),
        (("fell silent: it does not answer any more",) * 2, "hangs"),
        (("fell silent: it does not answer any more", "died: it ended with signal SIGSEGV"), "ends or hangs"),
    ],
)
def test_the_word_for_the_end_of_the_implementation_is_that_of_the_cases(deaths: tuple[str, str], word: str) -> None:
    run = [*ending("a", deaths[0]), *ending("b", deaths[1]), *results("", "xyz")]
    (found,) = explain(run, Dictionary((crashing("zero records", "a", "b"),))).faults
    assert found.what == f"{word} on zero records"


def test_the_sentence_of_a_fault_begins_with_the_crash_if_its_name_has_one() -> None:
    assert all(each.crashes == ("-dies" in each.id) for each in load().faults)


def test_cases_that_a_fault_leaves_undecided_are_not_explained_by_it() -> None:
    found = explain(results("abcd", "xyz"), Dictionary((fault("X", "a", "b", undecided=("c", "d")),)))
    assert named(found) == ["X"]
    assert found.faults[0].explains == ("a", "b")
    assert found.unexplained == ("c", "d")
    run = RunResult(cases=tuple(results("abcd")), diagnosis=found, requirements={"VD-RU-03": Verdict.FAIL})
    assert headline(run) == "0 requirements pass, 1 fails; 1 probable fault explains 2 of 4 failed cases"


def test_a_fault_of_which_few_cases_were_decided_is_not_named_before_one_of_which_all_were() -> None:
    known = Dictionary((fault("a rare one", *"abc"), fault("wide", *"abcdefghijklmnopq")))
    (found,) = explain(results("abc"), known).faults
    assert found.fault == "a rare one"
    assert found.alternatives == ("does wide",)


def test_a_fault_that_prevents_most_cases_is_not_probable_by_a_few() -> None:
    """A node that discards every beacon was reported to end a loop too early."""
    (found,) = explain(results("abcd"), Dictionary((fault("wide", *"abcdefghijklm"),))).faults
    assert (found.expected, found.signature, found.likely) == (4, 13, False)


def test_the_first_sentence_about_a_few_cases_is_not_false() -> None:
    found = selections(20, 1)
    assert len(found) == 20
    assert all(each.right and each.failed for each in found)


@pytest.mark.part("suite")
def test_a_change_that_the_dictionary_does_not_know_is_diagnosed_in_another_process() -> None:
    """The command draws changes; this one keeps the initial beacon period."""
    (site,) = (each for each in sites() if each.key == "9c1f4ab0d2b4")
    found = in_process(process_context(), site)
    assert found.failed == 5
    assert found.requirements == ("BP-PAR-02",)
    assert found.right
    assert summary([found]).startswith("1 state a requirement without hedge, 1 of them rightly; 0 are probable")
