"""``dcp-selftest model``: faulty nodes for the model alone."""

from __future__ import annotations

from pathlib import Path

import msgspec
import pytest
from click.testing import CliRunner
from dcp_conformance.stateful.corpus import Corpus, corpus
from dcp_selftest.cli.model import command
from dcp_selftest.modelled.campaign import searched
from dcp_selftest.modelled.faults import Fault, cells, mutants


@pytest.mark.parametrize("profile", ["dcp-2.0", "dcp-1.3"])
def test_each_cell_of_the_state_table_is_changed(profile: str) -> None:
    faults = [each.id for each in cells(profile)]
    assert len(faults) == len(set(faults)) > 200
    assert ("cell TIMED_OUT ALIVE_PRODUCER NONE" in faults) is (profile == "dcp-2.0")


def test_mutants_are_chosen_by_requirement() -> None:
    assert {each.id for each in mutants(("VD-RC-03",))} >= {"M-VD-RC-03-consumer-silent"}
    assert len(list(mutants())) > 600


def test_a_wrong_cell_is_found_by_the_sequences_of_a_run() -> None:
    found = searched(Fault("cell RX_CREATE_LATER UNKNOWN IGNORE", "dcp-2.0"), sequences=0, seed=1, shrink=False)
    assert found.by == "run"
    assert "VD-PC-07" in found.requirements


def test_sequences_are_added_to_those_of_a_run(tmp_path: Path) -> None:
    file = tmp_path / "sequences.json"
    arguments = ["--draw", str(file), "--sequences", "30", "--most", "2", "--seed", "5"]
    assert CliRunner().invoke(command, arguments, standalone_mode=False, catch_exceptions=False).return_value == 0
    written = msgspec.json.decode(file.read_bytes(), type=Corpus)
    before = corpus()
    assert len(before.sequences) <= len(written.sequences) <= len(before.sequences) + 2
    assert set(map(repr, before.sequences)) <= set(map(repr, written.sequences))
    assert written.seeds[-1] == 5
