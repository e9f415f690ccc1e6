"""``dcp-node explore``."""

from __future__ import annotations

import json

import pytest
from dcp_lab.explore.search import Search

from dcp_codec.capture import open_capture
from dcp_stack.cli import main


@pytest.fixture
def run(capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["explore", *map(str, arguments)])
        shown = capsys.readouterr()
        return ended.value.code, shown.out, shown.err

    return call


def test_violations_as_text(run):
    status, output, errors = run("--nodes", 2, "--deletions", 1, "--no-chart")
    assert (status, errors) == (1, "")
    head, *numbered, end = output.split("\n\n")
    assert head == "dcp-2.0: 2 nodes, 1 creation, 1 deletion, any loss"
    assert numbered == [
        "1. After lossless rounds a node has a variable that its producer has deleted [undeleted]\n"
        "   H10: A missed VarDelete is never repaired\n"
        "   events: create, delete, loss",
        "#  step                      node 0   node 1\n"
        "1  0: create 1.0             1.0      -\n"
        "2  0 sends VC 1.0 VS 0 to 1  1.0      1.0\n"
        "3  0: delete                 deleted  1.0\n"
        "4  0 sends VD to no node     deleted  1.0\n"
        "   lossless rounds: 2        deleted  1.0",
    ]
    assert end.startswith("1 violation, and no other in this space: ")


def test_a_space_without_violations_and_one_that_is_not_complete(run):
    status, output, _ = run("--nodes", 2, "--losses", 0)
    assert status == 0
    assert output.startswith(
        "dcp-2.0: 2 nodes, 1 creation, 0 losses\n"
        "No violation in this space: 4 states, 6 transitions, 3 steps deep (13 calls of real cores, "
    )
    status, output, _ = run("--updates", 9, "--max-states", 10)
    assert status == 4
    assert output.splitlines()[1].startswith("Not complete: no violation in the first ")


def test_an_interruption_keeps_what_was_found(run, monkeypatch):
    usual = Search._visit

    def interrupted(self, number, numbers):
        if number == 60:
            raise KeyboardInterrupt
        usual(self, number, numbers)

    monkeypatch.setattr(Search, "_visit", interrupted)
    status, output, _ = run("--deletions", 1)
    assert status == 1
    assert "\nNot complete: 3 violations in the first " in output


def test_json_with_a_scenario_and_a_recording_of_each_violation(run, tmp_path):
    status, output, _ = run("--nodes", 2, "--restarts", 1, "--json", "--out", tmp_path / "out")
    found = json.loads(output)
    assert (status, found["complete"]) == (1, True)
    assert [(each["hazard"], each["name"]) for each in found["violations"]] == [
        ("H2", "orphaned"),
        ("H2", "refused"),
        ("H1", "no-answer"),
    ]
    assert found["violations"][0]["steps"] == ["0: create 1.0", "0 sends VC 1.0 VS 0 to 1", "0: restart"]
    assert found["violations"][0]["held"] == [["1.0", "unknown"], ["1.0", "1.0"], ["unknown", "1.0"]]
    names = [f"{number:02}-{each['hazard']}-{each['name']}" for number, each in enumerate(found["violations"], 1)]
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        f"{name}.{kind}" for name in names for kind in ("mcap", "toml")
    ]
    for scenario, recording in (each["files"] for each in found["violations"]):
        with open_capture(recording) as frames:
            assert sum(1 for _ in frames) > 2
        with pytest.raises(SystemExit) as ended:
            main(["simulate", scenario, "--json"])
        assert ended.value.code == 0


def test_wrong_usage(run, tmp_path):
    assert run("--nodes", 5) == (2, "", "dcp-node: nodes: a network has 2 to 4 nodes, not 5\n")
    assert run(tmp_path / "none.toml")[0] == 2
    assert "unknown 'none'" in run("--proposal", "none")[2]
    refused = run("--nodes", 2, "--deletions", 1, "--proposal", "take-back", "--out", tmp_path)
    assert refused[0] == 2
    assert "simulate has the nodes of the specification only" in refused[2]
    assert "unknown profile 'dcp-9'" in run("--profile", "dcp-9")[2]
