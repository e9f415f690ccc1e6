"""Permitted variants: the suite fails none, and the campaign reports a node that is wrong or cannot be judged."""

from __future__ import annotations

import importlib
import pkgutil
from dataclasses import replace

import msgspec
import pytest
from dcp_conformance.definitions.case import SANITY, Case
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.runner import Runner
from dcp_conformance.execution.selection import ordered
from dcp_conformance.reference.surroundings import Setup
from dcp_conformance.reference.surroundings import Tested as Sut
from dcp_conformance.test_system.bench import Session
from dcp_selftest import variants
from dcp_selftest.mutants.mutant import all_mutants
from dcp_selftest.variants import ALL_VARIANTS, Variant, all_variants
from dcp_selftest.variants.campaign import VariantsResult, judge, trials_of
from dcp_selftest.variants.table import section
from dcp_selftest.variants.variant import setup
from dcp_selftest.variants.variant import variants_of as of_module
from dcp_spec.constants import SpecVersion

from ..conformance.rig import known_cases

#: A variant of each module that the suite treats fairly.
SAMPLE = (
    "V-X14-ignore-update-id",
    "V-UT-no-optional",
    "V-PAR-check-3-get",
    "V-BP-TX-sorted",
    "V-BP-VD",
    "V-TIME-check-200",
    "V-LIM-queue-5",
    "V-TYPE-var-seqno-2",
    "V-CLOCK-fast",
    "V-APP-client",
    "V-BUSY-mild-1",
)
PROFILE = "dcp-2.0"


def cases_about(method: str) -> list[Case]:
    """The first variant of each case that needs a service, in the order of execution."""
    found = {
        each.base: each for each in reversed(known_cases().values()) if any(method in one for one in each.needs.ut)
    }
    return ordered(found.values())


def some_cases(*ids: str):
    """The sanity case and some others, a tenth of the suite without ``ids``."""
    known = known_cases()
    # A case of the long plan sends 65,536 beacons: a minute for all modules, which the campaign spends, not this test.
    listed = [each for each in known.values() if not each.long]
    picked = [known[name] for name in ids] if ids else [*listed[::10], *listed[3::40]]
    return ordered({SANITY: known[SANITY], **{each.id: each for each in picked}}.values())


@pytest.mark.part("suite")
@pytest.mark.parametrize("name", SAMPLE)
def test_the_suite_is_fair_to_a_variant_of_each_module(name: str):
    found = judge(all_variants()[name], PROFILE, some_cases())
    assert (found.fails, found.inconclusive, found.errors) == ((), (), ())
    assert found.passed > 40


def with_period(variant: Variant, period_ms: int) -> Variant:
    """Return the variant with another beacon period, stated in the PIXIT."""

    def build(profile: str) -> Setup:
        found = variant.build(profile)
        config, pixit = found.config, found.pics.pixit
        bp = msgspec.structs.replace(config.bp, beacon_period_ms=period_ms)
        pixit = msgspec.structs.replace(pixit, beacon_period_ms=period_ms)
        return replace(
            found,
            config=msgspec.structs.replace(config, bp=bp),
            pics=msgspec.structs.replace(found.pics, pixit=pixit),
        )

    return replace(variant, build=build)


def test_frames_that_are_processed_periods_later_fail_no_case_about_deactivation():
    late = with_period(all_variants()["V-TIME-frames-150"], 30)
    found = judge(late, PROFILE, [known_cases()[SANITY], *cases_about("-MGMT-Deactivate")])
    assert (found.fails, found.inconclusive, found.errors) == ((), (), ())
    assert found.passed > 20


def test_reports_of_an_application_may_equal_data_of_an_earlier_case():
    """The application submits zeros, as cases about boundary values do."""
    found = all_variants()["V-APP-reports-10Hz"].build(PROFILE)
    sut = Sut(found)
    session = Session(found.config.codec, sut.lower_tester(), sut.connection(found.upper), found.pics)
    runner = Runner(session, sut)
    runner.prepare()
    assert runner.run(known_cases()[SANITY]).verdict is Verdict.PASS
    session.foreign_reports.submitted({each.name: 0 for each in found.config.safety_fields.numbers()}, sut.now)
    result = runner.run(known_cases()["TC_SRP_REC_TI_01"])
    assert result.verdict is Verdict.INCONCLUSIVE
    assert result.reason.endswith("an application on the node replaces the data by its own")


def test_the_sample_has_a_variant_of_each_module():
    modules = [
        importlib.import_module(f"{variants.__name__}.{info.name}") for info in pkgutil.iter_modules(variants.__path__)
    ]
    holding = [module for module in modules if of_module(module)]
    assert len(holding) == len(SAMPLE)
    for module in holding:
        assert {each.id for each in of_module(module)} & set(SAMPLE), module.__name__


def test_there_are_enough_variants_and_each_can_be_built_on_every_profile_it_applies_to():
    assert len(all_variants()) >= 100
    built = [
        (variant, profile, variant.build(profile)) for variant, profile in trials_of(list(all_variants().values()))
    ]
    assert {variant.id for variant, _, _ in built} == set(all_variants())
    for variant, _, made in built:
        # The text follows "the node" in a sentence.
        assert variant.what[0].islower(), variant.id
        assert variant.why, variant.id
        assert isinstance(made, Setup)


def test_the_explanation_of_an_inconclusive_verdict_names_its_reason():
    """An expression that matches whatever a case says would hide faults of the suite."""
    cases = known_cases()
    for variant in all_variants().values():
        for case in cases:
            assert not variant.explanation(case, "it continues, which this case needs: it does not answer"), variant.id
            assert not variant.explanation(case, ""), variant.id


def wrong(mutant: str) -> Variant:
    """A wrong node among the variants."""
    made = all_mutants()[mutant].make
    return Variant("V-WRONG", "is wrong", "nothing", lambda profile: setup(profile, make=made))


def test_a_wrong_node_among_the_variants_is_reported():
    found = judge(wrong("M-BP-HDR-01-two"), PROFILE, some_cases("TC_BP_HDR_BV_01"))
    assert not found.good
    assert found.fails
    assert VariantsResult(trials=(found,)).exit_status() == 1


def test_an_inconclusive_verdict_counts_unless_the_variant_explains_it():
    case = some_cases("TC_BP_HDR_BV_09")
    silent = Variant("V-SILENT", "sends in every beacon", "-", all_variants()["V-APP-every-beacon"].build)
    found = judge(silent, PROFILE, case)
    assert [each.case for each in found.inconclusive] == ["TC_BP_HDR_BV_09"]
    assert found.explained == 0
    explaining = Variant(
        silent.id, silent.what, silent.why, silent.build, explains=("^TC_BP_HDR_BV_09: no beacon during the pause",)
    )
    again = judge(explaining, PROFILE, case)
    assert (again.inconclusive, again.explained, again.good) == ((), 1, True)


def test_an_unused_explanation_is_reported():
    loud = all_variants()["V-APP-every-beacon"]
    explains = ("^TC_BP_HDR_BV_09: no beacon during the pause", "^TC_BP_HDR_BV_09: something else")
    variant = Variant(loud.id, loud.what, loud.why, loud.build, SpecVersion.V2_0, explains=explains)
    cases = some_cases("TC_BP_HDR_BV_09")
    one = VariantsResult(trials=(judge(variant, "dcp-2.0", cases),))
    # On other profiles it may be needed.
    assert one.idle([variant]) == {}
    both = VariantsResult(trials=(*one.trials, judge(variant, "cpp-2.0", cases)))
    assert both.idle([variant]) == {loud.id: [explains[1]]}


def test_a_variant_that_cannot_be_tested_is_an_error():
    def dies(*_: object) -> object:
        raise RuntimeError("out of order")

    broken = Variant("V-DEAD", "does not start", "nothing", lambda profile: setup(profile, make=dies))
    found = judge(broken, PROFILE, some_cases(SANITY))
    assert [each.reason for each in found.errors] == ["the node cannot be tested: RuntimeError: out of order"]
    assert VariantsResult(trials=(found,)).exit_status() == 4


def test_the_command_runs_a_variant_on_each_profile_that_has_its_freedom():
    picked = ALL_VARIANTS.select(["V-X27-*"])
    assert [profile for _, profile in trials_of(picked)] == ["dcp-2.0", "cpp-2.0"]
    with pytest.raises(UsageError, match="no variant is called"):
        ALL_VARIANTS.select(["V-X99-*"])


def test_the_section_of_the_document_shows_a_variant_that_fails():
    found = judge(wrong("M-BP-HDR-01-two"), PROFILE, some_cases("TC_BP_HDR_BV_01"))
    text = section(VariantsResult(trials=(found,)))
    assert text.startswith("## Permitted variants\n")
    assert "0 of 1 variants" in text
