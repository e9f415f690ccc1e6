"""Behaviour vectors: permitted nodes pass them, mutants do not, and every runner agrees."""

from __future__ import annotations

import json
import re
import shutil
import subprocess
from pathlib import Path

import msgspec
import pytest
from dcp_conformance.reference.inprocess import plain_node, reference_config
from dcp_conformance.vectors.behaviour import Event, Expect, Vector, judged, load, matches, profiles
from dcp_conformance.vectors.files import behaviour_digests, files
from dcp_selftest.mutants import all_mutants
from dcp_selftest.vectors.kills import Killed, Refused, Result, Results, failure, kill, ordered
from dcp_selftest.vectors.making import family, vector
from dcp_selftest.vectors.stimuli import recorded
from dcp_spec.catalogue.requirements import requirement

from dcp_codec import get_codec
from dcp_codec.export.c.adapter import adapter_files
from dcp_codec.export.c.files import codec_files

ROOT = Path(__file__).parents[2]
RUNNERS = ROOT / "examples" / "vectors"
C_NODE = ROOT / "examples" / "c-node"
ALL = {name: found for name in profiles() if (found := load(name)) is not None}
FOUND = ALL["dcp-2.0"]
VECTORS = {each.tc_id: each for each in FOUND.tests}


def test_vectors_keep_their_meaning() -> None:
    path = ROOT / "conformance" / "dcp_conformance" / "data" / "vector-digests.json"
    digests = json.loads(path.read_text())
    for profile, found in ALL.items():
        listed = digests[profile][f"{profile}/behaviour"]
        kept = {listed[at : at + 6] for at in range(0, len(listed), 6)}
        lost = kept - set(behaviour_digests(found))
        assert not lost, f"{profile}: {len(lost)} behaviour vectors are gone or mean something else"
        assert len({each.tc_id for each in found.tests}) == len(found.tests)


def test_every_expectation_names_a_requirement_of_the_version() -> None:
    for profile, found in ALL.items():
        named = set()
        for each in found.tests:
            assert each.requirements, each.tc_id
            named |= {name for name in each.requirements if "-" in name}
            named |= {one.requirement for one in each.expect} | {one.requirement for one in each.steps if one.status}
        version = get_codec(profile).profile.spec_version
        wrong = {name for name in named if not requirement(name).holds_in(version)}
        assert not wrong, f"{profile}: {sorted(wrong)}"


def test_the_reference_node_passes_and_a_mutant_fails() -> None:
    config = reference_config(get_codec("dcp-2.0"))
    some = FOUND.tests[::40]
    for each in some:
        assert not failure(each, config, plain_node), each.tc_id
    mutant = next(each for each in all_mutants().values() if each.requirement == "BP-HDR-01")
    assert kill("dcp-2.0", mutant, ordered(some, mutant)).vector


@pytest.mark.part("tools")
def test_permitted_nodes_pass() -> None:
    for profile, found in ALL.items():
        for number, (name, config, make) in enumerate(family(profile)):
            for each in found.tests[number % 60 :: 60]:
                assert not (why := failure(each, config, make)), f"{name} {each.tc_id}: {why}"


@pytest.mark.part("tools")
def test_the_same_steps_give_the_same_vector() -> None:
    """Nothing is drawn. Today's steps of a case may differ from those in its vector, which keeps its meaning."""
    wanted = [each.rpartition("/")[2] for each in VECTORS][::120]
    for case, stimuli in recorded(get_codec("dcp-2.0")):
        if case.id in wanted:
            made = vector("dcp-2.0", case, stimuli)
            assert made is not None
            assert msgspec.json.encode(made) == msgspec.json.encode(vector("dcp-2.0", case, stimuli)), case.id


def test_figures() -> None:
    killed, survivor = Killed("M-1", "dcp-2.0/wire/x", ""), Killed("M-2", "", "")
    good = Result(
        profile="dcp-2.0",
        vectors=3,
        nodes=("reference node",),
        refused=(),
        wire=(killed,),
        behaviour=(killed, survivor),
    )
    assert good.exit_status() == 1
    assert list(good.summary())[2] == "dcp-2.0: behaviour mutants: 1 of 2 (50.0 %) detected"
    text = Results((good, msgspec.structs.replace(good, profile="dcp-1.3"))).section()
    assert "| dcp-1.3 | 3 | 1 | 0 | 1 of 1 (100.0 %) | 1 of 2 (50.0 %) |" in text
    assert "| `M-2` | dcp-2.0, dcp-1.3 |" in text
    refused = Refused("reference node", "dcp-2.0/behaviour/x", "")
    for wire, behaviour, nodes, status in (
        ((killed,), (killed,), (), 0),
        ((killed,), (killed,), (refused,), 1),
        ((survivor,), (killed,), (), 1),
    ):
        result = msgspec.structs.replace(good, wire=wire, behaviour=behaviour, refused=nodes)
        assert result.exit_status() == status


def test_judging() -> None:
    expect = (Expect("record", 2, "01??", 100, 200, 1, 2, "VD-UPD-08"),)
    one = Vector("x", "", (), ("BP-RX-01",), 300, (), expect)

    def wrong(*times: int, octets: str = "0102") -> list[str]:
        return list(judged(one, [Event(time, "record", 2, octets) for time in times]))

    assert not wrong(100)
    assert not wrong(150, 200)
    assert "0 times" in wrong()[0]
    assert "3 times" in wrong(110, 120, 130)[0]
    assert "must not come" in wrong(99, 150)[0]
    assert "must not come" in wrong(150, 201)[0]
    assert "must not come" in wrong(150, octets="0202")[0]
    assert matches("0?", "0a")
    assert not matches("0?", "0a0b")


def written(folder: Path) -> Path:
    """Codec, adapter and vectors of 2.0 in a folder, with the example node."""
    codec = get_codec("dcp-2.0")
    for name, text in {**codec_files(codec), **adapter_files(codec)}.items():
        (folder / name).write_text(text)
    (folder / "behaviour.txt").write_bytes(dict(files(["dcp-2.0"], ["behaviour"]))["dcp-2.0/behaviour.txt"])
    for name in ("node.c", "node.h", "upper_tester.c", "upper_tester.h"):
        shutil.copy(C_NODE / name, folder)
    return folder


SOURCES = ("node.c", "upper_tester.c", "dcp_codec.c", "dcp_adapter.c")
RUNNER = tuple(RUNNERS / "c" / "behaviour" / name for name in ("vector.c", "sut.c", "main.c"))


@pytest.mark.tool("gcc")
def test_the_node_in_c_passes_and_a_wrong_one_fails(tmp_path: Path) -> None:
    written(tmp_path)
    strict = ["-std=c99", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-pedantic", "-Werror", "-g"]
    command = ["gcc", *strict, "-I.", *RUNNER, *SOURCES, "-o", "behaviour"]
    subprocess.run([*command, "-O1", "-fsanitize=address,undefined"], cwd=tmp_path, check=True)
    found = subprocess.run(["./behaviour", "behaviour.txt"], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 0, found.stdout + found.stderr
    assert found.stdout == f"{len(VECTORS)} vectors, 0 failed\n"
    source = (tmp_path / "node.c").read_text()
    (body,) = re.findall(r"static bool newer\(.*?\n\{\n(.*?)\n\}", source, re.DOTALL)
    (tmp_path / "node.c").write_text(source.replace(body, "    return one > other;"))
    subprocess.run(command, cwd=tmp_path, check=True)
    found = subprocess.run(["./behaviour", "behaviour.txt"], cwd=tmp_path, capture_output=True, text=True)
    assert found.returncode == 1
    assert "FAIL dcp-2.0/behaviour/" in found.stdout
