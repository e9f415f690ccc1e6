"""Legal nodes at corners of parameters and types: rare beacons, narrow and wide fields, X26, bare lists."""

from __future__ import annotations

from typing import Any

import msgspec
import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import CaseResult
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.execution.runner import Runner
from dcp_conformance.reference.inprocess import InProcess, VirtualUpperTester, reference_config
from dcp_conformance.test_system.bench import Bench, Session
from dcp_conformance.upper_tester import Answer
from dcp_spec.profile.loading import load_profile

from dcp_codec import Codec

from ...parts import also
from ..rig import codec_of, ids_of, known_cases

FINE = (Verdict.PASS, Verdict.INFO, Verdict.NOT_APPLICABLE)
SCRUBBING = [
    *ids_of("vardis.lifecycle.scrubbing", "vardis.lifecycle.timeouts", "vardis.lifecycle.init"),
    "TC_VD_TYP_BV_03",
]


def results(
    ids: list[str],
    *,
    codec: Codec | None = None,
    period_ms: int = 100,
    readings: dict[str, str] | None = None,
    vardis: dict[str, int] | None = None,
    kind: type[InProcess] = InProcess,
) -> dict[str, CaseResult]:
    """The results of cases against one node with this configuration."""
    config = reference_config(codec or codec_of("dcp-2.0"))
    config = msgspec.structs.replace(
        config,
        bp=msgspec.structs.replace(config.bp, beacon_period_ms=period_ms),
        vardis=msgspec.structs.replace(config.vardis, **(vardis or {})),
        readings={**config.readings, **(readings or {})},
    )
    sut = kind(config)
    pics = Pics(pixit=Testing(beacon_period_ms=period_ms))
    runner = Runner(Session(config.codec, sut.lower_tester(), sut.upper_tester(), pics), sut)
    runner.prepare()
    cases = known_cases()
    return {each: runner.run(cases[each]) for each in (SANITY, *ids) if not cases[each].long}


def not_fine(found: dict[str, CaseResult]) -> dict[str, str]:
    return {each: f"{result.verdict}: {result.reason}" for each, result in found.items() if result.verdict not in FINE}


@pytest.mark.parametrize("period_ms", [20, 300, 1000, 5000])
def test_variables_live_long_enough_to_be_seen_however_rare_beacons_are(period_ms: int):
    assert not not_fine(results(SCRUBBING, period_ms=period_ms))


@pytest.mark.part("suite")
@pytest.mark.parametrize("period_ms", [30, 1000, 5000])
def test_the_suite_is_fair_at_other_beacon_periods(period_ms: int):
    """Some cases mix times in ms and in beacon periods: a wait of one period may be longer than a timeout."""
    found = results([each for each in known_cases() if each != SANITY], period_ms=period_ms)
    assert not not_fine(found)
    assert sum(result.verdict is Verdict.PASS for result in found.values()) > 1_050


def test_only_producers_may_scrub():
    found = results(SCRUBBING, readings={"X26": "producer-only"})
    assert not not_fine(found)
    assert found["TC_VD_INI_BV_05"].readings == {"X26": "producer-only"}


def _profile(tmp_path: Any, types: str) -> Codec:
    path = tmp_path / "odd.toml"
    path.write_text(f'extends = "dcp-2.0"\nname = "odd"\n[types]\n{types}\n', encoding="utf-8")
    return Codec(load_profile(path))


def test_timeouts_of_one_octet_make_cases_with_longer_ones_not_applicable(tmp_path: Any):
    ids = [*SCRUBBING, *ids_of("vardis.services.create")]
    found = results(ids, codec=_profile(tmp_path, "var_timeout = { width = 1 }"))
    assert not not_fine(found)
    assert found["TC_VD_CRE_BV_01"].verdict is Verdict.PASS
    assert found["TC_VD_SCR_TI_01-200"].verdict is Verdict.PASS
    late = found["TC_VD_SCR_TI_01-1500"]
    assert late.verdict is Verdict.NOT_APPLICABLE
    assert "VarTimeoutT holds at most 255 ms" in late.reason


def test_layouts_of_other_versions_are_sent_with_the_identifiers_of_the_profile(tmp_path: Any):
    ids = ids_of("bp.beacons.robustness")
    found = results(ids, codec=_profile(tmp_path, "var_id = { width = 2 }"))
    assert not not_fine(found)
    assert found["TC_BP_RX_BI_20"].verdict is Verdict.PASS


class BareLists(VirtualUpperTester):
    """Describes the database with VarSpecT and nothing else, which is all that the specification demands."""

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        answer = super().call(method, params)
        for row in answer.result.get("variables", ()) if method == "RTDB-DescribeDatabase" else ():
            for extra in ("isDeleted", "tStamp"):
                row.pop(extra, None)
        return answer


class Bare(InProcess):
    def upper_tester(self) -> VirtualUpperTester:
        return BareLists(self)


def test_rows_of_the_database_need_no_more_than_a_specification():
    found = results([*ids_of("vardis.services.types", "vardis.services.read"), "TC_VD_DDB_BV_02"], kind=Bare)
    assert not not_fine(found)
    assert found["TC_VD_DB_BV_03-own"].verdict is Verdict.PASS
    reported = [each for each in found["TC_VD_DDB_BV_02"].checks if each.verdict is Verdict.INFO]
    assert [each.observed for each in reported] == ["none"]


@pytest.mark.part("suite")
@pytest.mark.parametrize(
    "vardis",
    [
        {"max_payload_size": 60, "max_value_length": 10, "max_description_length": 10, "max_summaries": 5},
        *also(
            "suite",
            {"max_value_length": 1, "max_description_length": 1},
            {"max_value_length": 4},
            {"max_description_length": 5},
        ),
    ],
    ids=str,
)
def test_small_limits_fail_no_case(vardis: dict[str, int]):
    ids = [each for each in known_cases() if each.startswith(("TC_VD", "TC_NET", "TC_DCP_DATA"))]
    assert not not_fine(results(ids, vardis=vardis))


def test_values_that_are_cut_stay_different():
    codec = codec_of("dcp-2.0")
    config = reference_config(codec)
    config = msgspec.structs.replace(config, vardis=msgspec.structs.replace(config.vardis, max_value_length=3))
    sut = InProcess(config)
    session = Session(codec, sut.lower_tester(), sut.upper_tester(), Pics())
    Runner(session, sut).prepare()
    bench = Bench(session, known_cases()[SANITY])
    words = [b"value", b"valley", b"val", b"v", b"valid", b"volume", bytes(range(200))]
    cut = [bench.records.value(each) for each in words]
    assert all(1 <= len(each) <= 3 for each in cut)
    assert cut[3] == b"v"
    assert [bench.records.value(each) for each in words] == cut == [bench.records.value(each) for each in cut]
    longer = [each for word, each in zip(words, cut, strict=True) if len(word) > 3]
    assert len(set(longer)) == len(longer)
    # A case about lengths says what it sends.
    assert bench.peer().create(1, value=b"value", exact=True).upd.value == b"value"
    assert bench.peer().update(1, 1, b"value").value == cut[0]


def test_a_full_database_of_an_unknown_size_is_alive() -> None:
    found = results(["TC_VD_DDB_BV_04", "TC_VD_PAY_BV_02-updates", "TC_VD_SUM_BV_01"], vardis={"max_variables": 20})
    assert not any(each.verdict is Verdict.FAIL for each in found.values()), not_fine(found)
