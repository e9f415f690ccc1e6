"""``dcp-selftest model``: faulty nodes for the model alone."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from dcp_conformance.reference.inprocess import reference_config
from dcp_conformance.stateful.corpus import Corpus, corpus
from dcp_conformance.stateful.driver import Counterexample, Driver
from dcp_conformance.stateful.steps import Beacon, Call, Records, Step, Wait
from dcp_conformance.stateful.virtual import VirtualExecutor
from dcp_selftest.cli.model import command
from dcp_selftest.generated.ledger import ledger
from dcp_selftest.generated.sites import sites
from dcp_selftest.modelled.campaign import Searched, searched
from dcp_selftest.modelled.excused import excused, run
from dcp_selftest.modelled.faults import DESCRIBED, Fault, cells, described, mutants
from dcp_selftest.modelled.table import section
from dcp_selftest.mutants import all_mutants

from dcp_codec.codec import get_codec


@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.3"])
def test_each_cell_of_the_state_table_is_changed(profile: str) -> None:
    faults = [each.id for each in cells(profile)]
    assert len(faults) == len(set(faults)) > 200
    assert ("cell TIMED_OUT ALIVE_PRODUCER NONE" in faults) is (profile == "dcp-2.0")


def test_mutants_are_chosen_by_requirement_or_identifier() -> None:
    assert {each.id for each in mutants(("VD-RC-03",))} >= {"M-VD-RC-03-consumer-silent"}
    assert [each.id for each in mutants(("M-VD-RC-03-consumer-silent",))] == ["M-VD-RC-03-consumer-silent"]
    assert len(list(mutants())) > 600


def test_a_wrong_cell_is_found_by_the_sequences_of_a_run() -> None:
    found = searched(Fault("cell RX_CREATE_LATER UNKNOWN IGNORE", "dcp-2.0"), sequences=0, seed=1, shrink=False)
    assert found.by == "run"
    assert "VD-PC-07" in found.requirements


#: By mutant: a sequence that shows it.
SHOWING: dict[str, tuple[Step, ...]] = {
    "M-BP-PTI-02-first-period": (
        Call("BP-RegisterProtocol", {
            "protId": 0, "name": 4, "maxPayloadSize": 20, "queueingMode": "BP_QMODE_REPEAT", "maxEntries": 1,
            "allowMultiplePayloads": False,
        }),
        Call("BP-TransmitPayload", {"protId": 0, "payload": 4}),
        Call("BP-SetParameter", {"name": "BPPAR_BEACON_PERIOD", "value": 50}),
        Wait(12),
    ),
    "M-VD-PAY-02-127-records": (Beacon(0, (Records("summary", 6, 200, 1),)), Wait(5)),
    "M-VD-DVA-03-no-count-delete": (
        Call("RTDB-Create", {"varId": 0, "repCnt": 15, "descr": 3, "value": 2, "timeout": 0}),
        Call("RTDB-Delete", {"varId": 0}),
    ),
    "M-VD-CRE-05-long-refused": (
        Call("VD-SetParameter", {"name": "VARDISPAR_MAX_VALUE_LENGTH", "value": 200}),
        Call("RTDB-Create", {"varId": 0, "repCnt": 1, "descr": 3, "value": 200, "timeout": 0}),
    ),
    "M-VD-SCR-03-consumer-double": (
        Beacon(0, (Records("create", 0, creation=1, timeout=5000),)), Wait(80), Wait(40),
    ),
    "M-VD-PC-08-pending-update-left": (
        Beacon(0, (Records("create", 0, creation=1, repetitions=15),)), Beacon(0, (Records("update", 0, seqno=1),)),
        Beacon(0, (Records("create", 0, creation=2, repetitions=15),)), Wait(8),
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", SHOWING)
def test_a_counterexample_names_the_requirement(name: str) -> None:
    mutant, config = all_mutants()[name], reference_config(get_codec("dcp-2.0"))
    Driver(VirtualExecutor(config)).run(SHOWING[name])
    with pytest.raises(Counterexample) as caught:
        Driver(VirtualExecutor(config, make=mutant.make)).run(SHOWING[name])
    assert set(caught.value.finding.requirements) & set(mutant.requirements)


def test_a_counterexample_of_a_run_is_made_shorter() -> None:
    fault = Fault("M-BP-LST-01-cut-at-31", "dcp-2.0")
    whole, short = (searched(fault, sequences=0, seed=1, shrink=shrink) for shrink in (False, True))
    assert whole.by == short.by == "run"
    assert 1 == short.steps < whole.steps
    assert "BP-RegisterProtocol" in short.text


def test_the_described_faults_make_a_section_of_the_document() -> None:
    assert [each.id for each in described()] == list(DESCRIBED)
    assert {each.about for each in described()} == {"bp", "srp", "vardis"}
    one, two, three = (Fault(each, "dcp-2.0") for each in DESCRIBED[:3])
    text = section(
        [
            Searched(two, "run", ("BP-REG-06",), 4, 39, 0.12),
            Searched(one, "", sequences=400, seconds=6.0),
            Searched(three, "search", ("BP-MGT-02",), 7, 160, 1.0),
        ],
        400,
        3,
    )
    assert "2 of 3 are found, 1 by the sequences of a run." in text
    assert "violated requirement in 1. Median length: 5.5 steps." in text
    rows = [line for line in text.splitlines() if line.startswith("| `M-")]
    assert [line.split("`")[1] for line in rows] == list(DESCRIBED[:3])
    assert rows[0].endswith("| `run --plan long` | - | - | 6.0 |")
    assert rows[2].endswith("| search | BP-MGT-02 (another) | 7 | 1.0 |")


def test_a_change_that_the_model_can_observe_is_refuted() -> None:
    [site] = [each for each in sites() if "Database.store: dropped assignment: entry.value = value" in str(each)]
    [(found, result)] = run([site], sequences=0, seed=1, jobs=1)
    assert found is site
    assert result.by == "run"


def test_a_change_of_no_protocol_is_searched_with_all_themes() -> None:
    site = next(each for each in sites() if "StampClock.between: arithmetic" in str(each))
    [(_, result)] = run([site], sequences=2, seed=1, jobs=1)
    assert (result.by, result.sequences) == ("", 2)


def test_a_sample_of_the_ledger_is_the_same_for_a_seed() -> None:
    assert excused(5, 3) == excused(5, 3) != excused(5, 4)
    assert len(excused(None, 1)) == len(ledger())


def test_sequences_are_added_to_those_of_a_run(tmp_path: Path) -> None:
    file = tmp_path / "sequences.json"
    arguments = ["--draw", str(file), "--sequences", "30", "--most", "2", "--seed", "5"]
    assert CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False).return_value == 0
    written = msgspec.json.decode(file.read_bytes(), type=Corpus)
    before = corpus()
    assert len(before.sequences) <= len(written.sequences) <= len(before.sequences) + 2
    assert set(map(repr, before.sequences)) <= set(map(repr, written.sequences))
    assert written.seeds[-1] == 5
