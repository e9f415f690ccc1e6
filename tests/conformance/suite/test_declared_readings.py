"""Readings that a PICS declares: accepted if they are observed, failed by the case that observes another one."""

from __future__ import annotations

import multiprocessing
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.definitions.case import SANITY
from dcp_conformance.definitions.pics import Pics, load_pics
from dcp_conformance.definitions.pics_file import pics_text
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_conformance.reference.inprocess import plain_node
from dcp_selftest.generated.sites import sites
from dcp_selftest.generated.trial import Step, cases, try_site
from dcp_spec.catalogue.readings import readings

from ..rig import one_case

#: A case that observes a reading, and two alternatives of it.
OBSERVED = [
    ("X02", "TC_BP_RX_BV_07", "length-field", "frame-size"),
    ("X03", "TC_BP_INI_BV_01", "write-then-increment", "increment-then-write"),
    ("X05", "TC_BP_PAR_BV_02", "literal-minimum", "usable-minimum"),
    ("X06", "TC_BP_REG_BI_05-BP_QMODE_LIFO", "refuse-at-registration", "refuse-at-clear"),
]


def node_that_follows(identifier, name):
    def make(config, *rest):
        return plain_node(msgspec.structs.replace(config, readings={identifier: name}), *rest)

    return make


@pytest.mark.parametrize(("identifier", "case_id", "ours", "other"), OBSERVED)
def test_the_declared_alternative_passes(identifier, case_id, ours, other):
    for name in (ours, other):
        result = one_case(case_id, make=node_that_follows(identifier, name), pics=Pics(readings={identifier: name}))
        assert result.verdict is not Verdict.FAIL, result.reason
        assert result.readings[identifier] == name


@pytest.mark.parametrize(("identifier", "case_id", "ours", "other"), OBSERVED)
def test_another_alternative_than_the_declared_one_fails(identifier, case_id, ours, other):
    for declared, followed in ((ours, other), (other, ours)):
        pics = Pics(readings={identifier: declared})
        result = one_case(case_id, make=node_that_follows(identifier, followed), pics=pics)
        assert result.verdict is Verdict.FAIL
        assert f"{declared}, as declared in the PICS" in result.reason
        assert result.readings[identifier] == followed


@pytest.mark.parametrize(("identifier", "case_id", "ours", "other"), OBSERVED)
def test_without_a_declaration_both_are_permitted(identifier, case_id, ours, other):
    for name in (ours, other):
        assert one_case(case_id, make=node_that_follows(identifier, name)).verdict is not Verdict.FAIL


def test_every_alternative_of_the_catalogue_can_be_declared(tmp_path: Path):
    for place in range(2):
        declared = Pics(
            readings={each.id: each.alternatives[place].name for each in readings().values() if each.alternatives}
        )
        path = tmp_path / f"{place}.toml"
        path.write_text(pics_text(declared), encoding="utf-8")
        assert load_pics(path) == declared


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('X5 = "literal-minimum"', "no reading 'X5'; did you mean X5"),
        ('X05 = "minimum"', "readings.X05: reading X05 has no alternative 'minimum'; it has: literal-minimum, usable"),
        ('X29 = "nothing"', "reading X29 has no alternative 'nothing'; it has: none"),
        ("X05 = 3", "Expected `str`, got `int`"),
    ],
)
def test_a_wrong_declaration_is_a_usage_error(tmp_path: Path, text: str, message: str):
    path = tmp_path / "mine.pics.toml"
    path.write_text(f"[readings]\n{text}\n", encoding="utf-8")
    with pytest.raises(UsageError, match=r"mine\.pics\.toml") as error:
        load_pics(path)
    assert message in str(error.value)


@pytest.mark.parametrize("name", ["keep-prefix", "skip-container"])
def test_a_container_that_cannot_be_skipped_contradicts_neither(name):
    """The end of a container of unknown type cannot be found; skipping it looks like keeping what precedes it."""
    make = node_that_follows("X34", name)
    result = one_case("TC_VD_ROB_BI_01-type-7", make=make, pics=Pics(readings={"X34": name}))
    assert result.readings == {"X34": "keep-prefix"}
    assert result.verdict is not Verdict.FAIL, result.reason


@pytest.mark.part("suite")
def test_a_generated_mutant_that_switches_a_reading_is_killed():
    before = "1 if readings.first_seqno == 'increment-then-write'"
    switched = next(each for each in sites() if each.operator == "branch" and each.before.startswith(before))
    numbers = tuple(place for place, case in enumerate(cases()) if case.id in (SANITY, "TC_BP_INI_BV_01"))
    plan = (Step("dcp-2.0", numbers),)
    with ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn")) as pool:
        outcome = pool.submit(try_site, switched, plan).result()
    assert outcome.fate == "killed"
    assert "as declared in the PICS" in outcome.by
