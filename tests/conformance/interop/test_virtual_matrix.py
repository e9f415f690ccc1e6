"""Cells in virtual time: our node passes, faults turn cells red, equal seeds do the same, reports hold all of it."""

from __future__ import annotations

import dataclasses
import json
import xml.etree.ElementTree as ET
from importlib import resources
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.errors import UsageError
from dcp_lab.interop import implementations
from dcp_lab.interop.bounds import attempts
from dcp_lab.interop.cell import Cell, run_cell
from dcp_lab.interop.definition import GRID_8, LINE_5, PAIR, all_tests, network_test
from dcp_lab.interop.implementations import BUILT_IN, built_in, load_description, virtual_setup
from dcp_lab.interop.matrix import cells_of, parse_only, run_matrix
from dcp_lab.interop.nodes.virtual import VirtualWorld
from dcp_lab.interop.reporting import load_matrix, write_reports
from dcp_lab.interop.results import CellResult
from dcp_lab.interop.scene import MS, SECOND, Scene
from dcp_selftest.interop import FAULTS, variants_to_try
from dcp_selftest.variants.variant import all_variants

from ...parts import every
from ..command import Command

NODE = "node:dcp-2.0"


def play(a: str, b: str, test: str, seed: int = 1) -> CellResult:
    cell = Cell(a=a, b=b, test=test, implementations=(built_in(a), built_in(b)), seed=seed)
    return run_cell(cell, all_tests()[test])


@pytest.mark.parametrize("test", every(6, sorted(all_tests())))
def test_our_node_passes_every_network_test(test: str) -> None:
    a, b = (NODE, "node:dcp-1.3") if all_tests()[test].wire == "different" else (NODE, NODE)
    result = play(a, b, test)
    assert result.verdict is Verdict.PASS, result.reason
    assert result.checks


@pytest.mark.parametrize("profile", BUILT_IN[1:])
@pytest.mark.parametrize(
    "test", ["IT_VD_CREATE-line3", "IT_VD_LOSS-pair-30", "IT_VD_PARTITION-bus4", "IT_VD_DELETE-pair"]
)
def test_our_node_passes_in_every_version(profile: str, test: str) -> None:
    assert play(profile, profile, test).verdict is Verdict.PASS


@pytest.mark.parametrize(
    ("fault", "test"),
    [
        ("M-VD-PC-09-own-only", "IT_VD_RECREATE-line3"),
        ("M-VD-PU-07-ignored", "IT_VD_UPDATE-pair"),
        ("M-VD-PS-04-not-requested", "IT_VD_PARTITION-pair"),
        ("M-VD-PD-04-not-sent-on", "IT_VD_DELETE-line3"),
        ("M-VD-DB-02-forgets", "IT_VD_PARTITIONEDCREATE-line5"),
        ("M-BP-RX-16-dies-of-short", "IT_NET_MALFORMED-pair"),
        ("M-SRP-RX-06-forwarded", "IT_SRP_DISCOVERY-line3"),
        ("M-VD-SCR-06-not-refreshed", "IT_VD_TIMEOUT-pair"),
    ],
)
def test_a_fault_fails_a_cell(fault: str, test: str) -> None:
    result = play(NODE, f"mutant:{fault}", test)
    assert result.verdict is Verdict.FAIL
    assert result.reason


def test_runs_depend_on_the_seed_only() -> None:
    one, again, other = (play(NODE, NODE, "IT_VD_LOSS-line3-50", seed) for seed in (3, 3, 4))
    assert one.moments == again.moments
    assert one.links == again.links
    assert one.moments != other.moments


def test_incompatible_versions_share_a_bus_without_interaction() -> None:
    assert play(NODE, "node:dcp-1.3", "IT_NET_MIXED-bus4").verdict is Verdict.PASS
    missing = play(NODE, "node:dcp-1.3", "IT_VD_CREATE-pair")
    assert missing.verdict is Verdict.NOT_APPLICABLE
    assert "in common" in missing.reason


def test_lists_of_faults_and_variants_have_the_documented_lengths() -> None:
    assert len(FAULTS) >= 25
    assert len(variants_to_try()) >= 50


def test_no_identifier_is_used_again() -> None:
    ledger = resources.files("dcp_conformance").joinpath("data", "interop-test-ids.txt").read_text()
    known = {line for line in ledger.splitlines() if line and not line.startswith("#")}
    assert set(all_tests()) <= known, "add new identifiers to data/interop-test-ids.txt"


def test_an_identifier_has_a_form() -> None:
    with pytest.raises(ValueError, match="is not an identifier"):
        network_test("TC_VD", "p", requirements="VD-PC-07", shapes=(LINE_5,))


def test_hops_of_networks() -> None:
    assert LINE_5.hops(0) == {0: 0, 1: 1, 2: 2, 3: 3, 4: 4}
    assert max(GRID_8.hops(0).values()) == 4
    assert GRID_8.hops(0, {0, 1, 4, 6}) == {0: 0, 1: 1, 4: 1}
    assert GRID_8.neighbours(0) == (1, 4)


def test_attempts_grow_with_loss_and_hops() -> None:
    assert attempts(4, 1.0) == 4
    # Each attempt fails with probability 1/2: 20 of them fail together with less than 1e-6.
    assert attempts(1, 0.5) == 20
    assert attempts(2, 0.5) > attempts(1, 0.5) > attempts(1, 0.75)


def test_names_of_cells() -> None:
    assert parse_only(["node:dcp-2.0:mutant:M-X-01-a@dcp-1.3:IT_VD_CREATE-pair"]) == [
        ("node:dcp-2.0", "mutant:M-X-01-a@dcp-1.3", "IT_VD_CREATE-pair")
    ]
    assert parse_only(["ours:theirs:IT_VD_CREATE-pair"]) == [("ours", "theirs", "IT_VD_CREATE-pair")]
    with pytest.raises(UsageError, match="expected A:B:TEST"):
        parse_only(["ours:IT_VD_CREATE-pair"])


@pytest.mark.parametrize("test", ["IT_VD_CREATE-pair", "IT_SRP_DISCOVERY-pair"])
def test_declarations_of_the_common_profile_fail_no_cell(test: str, tmp_path: Path) -> None:
    # Both implementations have agreed on its byte order and padding, which do not affect the network.
    name = "node:cpp-2.0"
    matrix = run_matrix(cells_of({name: built_in(name)}, [all_tests()[test]]), jobs=1, folder=tmp_path)
    (cell,) = matrix.cells
    assert cell.verdict is Verdict.PASS, cell.reason
    (described,) = matrix.implementations
    assert {"DATA-01", "DATA-02"} <= set(described.declared)
    page = write_reports(matrix, tmp_path)
    for text in (page.read_text(), (tmp_path / "interop.md").read_text()):
        assert "DATA-01" in text
        assert "little-endian: timestamp" in text


def test_a_conforming_profile_declares_nothing() -> None:
    matrix = run_matrix(cells_of({NODE: built_in(NODE)}, [all_tests()["IT_VD_CREATE-pair"]]), jobs=1)
    assert matrix.implementations[0].declared == {}


@pytest.mark.parametrize(
    ("fault", "test"),
    [
        ("M-VD-PU-07-ignored", "IT_VD_LOSS-pair-10"),
        ("M-VD-PD-04-ignored", "IT_VD_DELETE-pair"),
        ("M-SRP-RX-06-forwarded", "IT_SRP_DISCOVERY-line3"),
    ],
)
def test_the_first_change_that_is_too_late_ends_the_cell(fault: str, test: str) -> None:
    # Each change may take 11 s here, 95 s at a loss of 50 %, and three times that in real time.
    result = play(NODE, "mutant:" + fault, test)
    assert result.verdict is Verdict.FAIL
    assert [spread.took is None for spread in result.spreads] == [*[False] * (len(result.spreads) - 1), True]


@pytest.mark.parametrize("off", [False, True])
def test_time_without_listening_does_not_make_a_station_silent(off: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    # In real time 500 calls of services take seconds.
    def deaf(scene: Scene) -> None:
        scene.start()
        scene.create(0, 10, b"a")
        scene.expect_spread(0, 10)
        heard = dict(scene.heard_from)
        scene.world.run(5 * SECOND)
        scene._look()
        if off:
            scene.world.power(1, on=False)
            monkeypatch.setattr(scene.world, "is_on", lambda place: True)
        scene.heard_from = heard
        scene.expect_talking()

    test = dataclasses.replace(all_tests()["IT_VD_CREATE-pair"], run=deaf)
    result = run_cell(Cell(a=NODE, b=NODE, test=test.id, implementations=(built_in(NODE), built_in(NODE))), test)
    assert result.verdict is (Verdict.FAIL if off else Verdict.PASS), result.reason
    assert not off or "silent: place 1" in result.reason


def test_reports_hold_every_cell(tmp_path: Path) -> None:
    fault = "mutant:M-VD-PU-07-ignored"
    found = {name: built_in(name) for name in (NODE, fault)}
    tests = [all_tests()["IT_VD_UPDATE-pair"]]
    matrix = run_matrix(cells_of(found, tests), jobs=1, folder=tmp_path)
    page = write_reports(matrix, tmp_path)
    assert load_matrix(tmp_path) == matrix
    assert matrix.counts() == {"pass": 2, "fail": 2}
    cases = ET.parse(tmp_path / "junit.xml").getroot().iter("testcase")
    assert len(list(cases)) == 4
    assert "2 of 4" not in (tmp_path / "interop.md").read_text()
    text = page.read_text()
    assert text.count('class="msc"') == 4
    for cell in matrix.cells:
        assert (tmp_path / cell.recording).is_file()
        assert cell.recording in text
        for station in cell.stations:
            assert (tmp_path / station.recording).is_file()
    assert len(list((tmp_path / "failed").iterdir())) == 2


def test_a_failed_cell_replays(tmp_path: Path, dcp_conformance: Command) -> None:
    fault = "mutant:M-VD-PS-04-not-requested"
    result = play(NODE, fault, "IT_VD_PARTITION-pair", seed=7)
    assert result.verdict is Verdict.FAIL
    file = tmp_path / "cell.json"
    file.write_bytes(msgspec.json.encode(result))
    status, told, _ = dcp_conformance("interop", "--replay", file)
    assert status == 1
    assert "before:" not in told, "the replay must fail for the same reason"
    assert "1 fail" in told


def test_seeds_are_all_played(tmp_path: Path) -> None:
    fault = "mutant:M-VD-PU-07-not-sent-on"
    found = {name: built_in(name) for name in (NODE, fault)}
    cells = cells_of(found, [all_tests()["IT_VD_UPDATE-pair"]], rows=[NODE], columns=[fault])
    (result,) = run_matrix(cells, seeds=3, jobs=1).cells
    assert result.seeds == 3


@pytest.mark.parametrize(
    ("text", "complaint"),
    [
        ("", "implementation"),
        ("[implementation.a]\nprofile = 'dcp-2.0'\n", "implementation.a: give either"),
        ("[implementation.a]\nstart = 'x {nowhere}'\n", "there is no placeholder {nowhere}"),
        ("[implementation.a]\nbuilt_in = 'mutant:M-NO'\n", "no mutant is called 'M-NO'"),
        ("[implementation.a]\nbuilt_in = 'node'\nprofile = 'dcp-9'\n", "implementation.a"),
        ("[implementation.a]\nbuilt_in = 'node'\n[matrix]\nrows = ['b']\n", "'b' is not described"),
        ("[implementation.a]\nbuilt_in = 'node'\nsize = 3\n", "size"),
        ("[implementation.a]\nstart = 'x'\nready = 'upper-tester'\n", "needs the key upper_tester"),
    ],
)
def test_a_bad_description_is_refused_by_key(tmp_path: Path, text: str, complaint: str) -> None:
    path = tmp_path / "interop.toml"
    path.write_text(text)
    with pytest.raises(UsageError, match=r"interop\.toml") as refusal:
        load_description(path)
    assert complaint in str(refusal.value)


@pytest.mark.parametrize(
    ("name", "advice"),
    [
        ("mutant:M-ABSENT", "pip install ./selftest"),
        ("variant:V-ABSENT", "dcp-conformance-selftest"),
        ("drone:X", "is not a built-in implementation"),
    ],
)
def test_nodes_that_no_installed_package_offers_are_refused(
    name: str, advice: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(implementations, "entry_points", lambda **_: ())
    with pytest.raises(UsageError, match=advice):
        built_in(name)


def test_a_description_is_played(tmp_path: Path, dcp_conformance: Command) -> None:
    path = tmp_path / "interop.toml"
    path.write_text(
        "[implementation.ours]\nbuilt_in = 'node'\n[implementation.jittery]\nbuilt_in = 'variant:V-BP-TX-jitter-25'\n"
        "[matrix]\ntests = ['IT_VD_CREATE-pair']\n"
    )
    status, told, _ = dcp_conformance("interop", path, "--virtual", "--jobs", 1, "--report-dir", tmp_path / "report")
    assert status == 0
    assert "4 pass" in told
    cells = json.loads((tmp_path / "report" / "interop.json").read_text())["cells"]
    assert [(cell["a"], cell["b"]) for cell in cells] == [
        ("ours", "ours"), ("ours", "jittery"), ("jittery", "ours"), ("jittery", "jittery"),
    ]  # fmt: skip


@pytest.mark.parametrize(
    ("words", "advice"),
    [(["--seeds", "3"], "add --virtual"), (["--virtual", "--test", "IT_NO"], "interop --list")],
)
def test_usage_errors_give_a_remedy(words: list[str], advice: str, dcp_conformance: Command) -> None:
    status, _, told = dcp_conformance("interop", *words)
    assert status == 2
    assert advice in told


def test_every_permitted_variant_starts() -> None:
    for name in variants_to_try():
        profiles = [each.partition(":")[2] for each in BUILT_IN]
        profile = next(each for each in profiles if all_variants()[name].applies_to(each))
        each = built_in(f"variant:{name}@{profile}")
        world = VirtualWorld([(name, *virtual_setup(each, each.profile))] * 2, PAIR)
        world.power(0, on=True)
        world.run(300 * MS)
        assert world.deaths() == {}, name
