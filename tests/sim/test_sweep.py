"""``dcp-node sweep``: plans, resumed studies, estimates and bundles."""

from __future__ import annotations

import base64
import csv
import json
import math
import statistics
import sys
from operator import itemgetter

import pytest
from dcp_lab.sim.measuring.values import DelayRow
from dcp_lab.sim.scenario.definition import ScenarioError
from dcp_lab.sim.sweep.plan import load_study, study_from
from dcp_lab.sim.sweep.results import Estimate, Outcome, outcome, stored, summaries

from dcp_codec.common.extras import advice
from dcp_stack.cli import main

# Processes, Parquet and plots.
pytestmark = pytest.mark.part("tables")

STUDY = """
nodes = 3
duration_s = 3.0
topology = "line"
srp = false
events = [
  { do = "create", node = 0, variable = 1, at_s = 0.5, text = "0" },
  { do = "update", node = 0, variable = 1, at_s = 1.0, every_s = 0.3, times = 5, text = "{n}" },
]
[sweep]
seeds = 2
"link.loss" = [0.0, 0.4]
"events.*.repetitions" = [1, 2]
"""


@pytest.fixture
def run(capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main(["sweep", *map(str, arguments)])
        shown = capsys.readouterr()
        return ended.value.code, shown.out, shown.err

    return call


@pytest.fixture
def study(tmp_path):
    path = tmp_path / "study.toml"
    path.write_text(STUDY)
    return path


def test_runs_are_all_combinations_with_all_seeds(study):
    found = load_study(study)
    assert found.axes == ("link.loss", "events.*.repetitions")
    assert [tuple(each.values()) for each in found.cells] == [(0.0, 1), (0.0, 2), (0.4, 1), (0.4, 2)]
    runs = found.runs("study")
    assert [(each.cell, each.seed) for each in runs] == [(cell, seed) for cell in range(4) for seed in (1, 2)]
    assert len({each.key for each in runs}) == 8
    assert runs[-1].scenario.link.loss == 0.4
    assert runs[-1].scenario.events[0].repetitions == 2
    zipped = study.with_name("zipped.toml")
    zipped.write_text(STUDY + "zipped = true\n")
    assert [tuple(each.values()) for each in load_study(zipped, 1).cells] == [(0.0, 1), (0.4, 2)]


def test_a_study_is_resumed_and_verified(run, study, tmp_path):
    out = tmp_path / "study"
    status, output, _ = run(study, "--jobs", 1)
    assert status == 0
    assert output.startswith("8 of 8 runs (0 resumed), ")
    names = [
        *("bundle.json", "page.html", "plot.png", "plot.svg", "runs.csv", "runs.jsonl", "runs.parquet", "table.csv")
    ]
    assert sorted(each.name for each in out.iterdir()) == names
    names.remove("runs.jsonl")
    first = {name: (out / name).read_bytes() for name in names if name != "runs.parquet"}
    assert first["plot.png"].startswith(b"\x89PNG")
    # The page has the plot, and the rows of the table on the terminal.
    page = first["page.html"].decode()
    assert base64.b64encode(first["plot.svg"]).decode() in page
    assert page.count("<tr>") == 5
    assert "fewer than 10 receptions" in output
    assert "fewer than 10 receptions" in page
    # The rows of nodes add up to those of their distance.
    rows = list(csv.DictReader((out / "runs.csv").read_text().splitlines()))
    whole, nodes = ([each for each in rows if (each["node"] == "") is one] for one in (True, False))
    key = itemgetter("link.loss", "events.*.repetitions", "seed", "kind", "hops")
    for row in whole:
        parts = [each for each in nodes if key(each) == key(row)]
        assert sum(int(each["received"]) for each in parts) == int(row["received"]) > 0
        assert sum(int(each["due"]) for each in parts) == int(row["due"])
    # An incomplete last line, as after a loss of power.
    lines = (out / "runs.jsonl").read_bytes().splitlines(keepends=True)
    (out / "runs.jsonl").write_bytes(b"".join(lines[:3]) + lines[3][:50])
    status, output, _ = run(study, "--jobs", 2)
    assert (status, output.partition(",")[0]) == (0, "8 of 8 runs (3 resumed)")
    assert {name: (out / name).read_bytes() for name in first} == first
    assert run(study, "--verify", out / "bundle.json", "--jobs", 1)[:2] == (0, "8 of 8 runs have the same digest\n")
    bundle = json.loads(first["bundle.json"])
    bundle["digests"] = dict.fromkeys(bundle["digests"], "0" * 64)
    (out / "bundle.json").write_text(json.dumps(bundle))
    status, output, _ = run(study, "--verify", out / "bundle.json", "--jobs", 1)
    assert status == 1
    assert output.endswith("0 of 8 runs have the same digest\n")


def test_an_interruption_keeps_the_runs_that_are_done(run, study, tmp_path, monkeypatch):
    from dcp_codec.common import workers

    def interrupted(work, items, _jobs):
        for place, item in enumerate(items):
            if place == 3:
                raise KeyboardInterrupt
            yield place, work(item)

    monkeypatch.setattr(workers, "completed", interrupted)
    status, output, _ = run(study)
    assert status == 4
    assert output.startswith("3 of 8 runs (0 resumed), ")
    assert len(stored(tmp_path / "study" / "runs.jsonl")) == 3


def test_the_table_has_means_over_seeds(run, study, tmp_path):
    run(study, "--jobs", 1)
    found = load_study(study)
    outcomes = [outcome(each) for each in found.runs("study")]
    with (tmp_path / "study" / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert [(each["link.loss"], each["events.*.repetitions"]) for each in rows[::4]] == [
        ("0.0", "1"),
        ("0.0", "2"),
        ("0.4", "1"),
        ("0.4", "2"),
    ]
    for row in rows:
        cell = next(
            number for number, each in enumerate(found.cells) if [*map(str, each.values())] == [*row.values()][:2]
        )
        delays = [
            delay
            for each in outcomes
            if each.cell == cell
            for delay in each.delays
            if (delay.kind, str(delay.hops)) == (row["kind"], row["hops"])
        ]
        assert int(row["received"]) == sum(each.received for each in delays)
        assert float(row["share"]) == pytest.approx(statistics.fmean(each.share for each in delays))
        assert row["few"] == str(int(row["received"]) < 10)


def outcome_of(cell, seed, share, mean_ms, received=20):
    row = DelayRow("update", 2, 20, received, 20 - received, share, mean_ms)
    values = {"digest": "", "met": True, "newest": None, "octets": 0, "beacons": 0, "cpu_s": 0.0}
    return Outcome(key=f"{cell}/{seed}", cell=cell, seed=seed, delays=[row], **values)


def test_differences_are_those_of_pairs_with_the_same_seed():
    """Differences of 1, 2 and 3 ms, though the seeds differ by 1000 ms; a seed of one cell only has no pair."""
    before = [outcome_of(0, seed, 0.5, 1000.0 * seed) for seed in (1, 2, 3, 4)]
    after = [outcome_of(1, seed, 0.75, 1000.0 * seed + seed) for seed in (1, 2, 3)]
    plain, paired = summaries([*after, *before], {1: 0})
    assert plain.differences == {}
    assert paired.differences["share"] == Estimate(0.25, 0.0)
    assert paired.differences["delay_ms"].mean == 2.0
    assert paired.differences["delay_ms"].half == pytest.approx(4.303 / math.sqrt(3))
    assert paired.differences["delay_ms"].text(1, signed=True) == "+2.0 +- 2.5"
    assert "newest" not in paired.differences
    assert paired.delay_ms.half > 1000


def test_the_preceding_cell(study, tmp_path):
    found = load_study(study)
    assert (found.compare, found.preceding()) == ("events.*.repetitions", {1: 0, 3: 2})
    raw = {**found.raw, "sweep": {**found.raw["sweep"], "compare": "link.loss"}}
    assert study_from(raw, tmp_path, "study").preceding() == {2: 0, 3: 1}
    raw["sweep"]["zipped"] = True
    assert study_from(raw, tmp_path, "study").preceding() == {1: 0}
    assert study_from({"sweep": {}}, tmp_path, "study").preceding() == {}


def test_the_table_compares_repetitions(run, study, tmp_path):
    _, output, _ = run(study, "--jobs", 1)
    lines = output.splitlines()
    header = next(line for line in lines if "repetitions" in line).split()
    assert header == ["loss", "repetitions", "hops", "share", "change", "delay", "ms", "newest", "n"]
    assert "change: difference of the share from the preceding repetitions" in output
    with (tmp_path / "study" / "table.csv").open() as file:
        rows = [each for each in csv.DictReader(file) if (each["kind"], each["hops"]) == ("update", "2")]
    for one, two in zip(rows[::2], rows[1::2], strict=True):
        assert one["share_difference"] == ""
        assert float(two["share_difference"]) == pytest.approx(float(two["share"]) - float(one["share"]))
    # Without losses a second transmission changes nothing, in no pair.
    assert (rows[1]["share_difference"], rows[1]["share_difference_ci95"]) == ("0.0", "0.0")


def test_without_the_extra_the_tables_are_written(run, study, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    monkeypatch.delitem(sys.modules, "dcp_lab.sim.sweep.plot", raising=False)
    status, _, errors = run(study, "--jobs", 1)
    assert status == 0
    assert f"without plot.svg, plot.png and page.html: {advice('matplotlib')}" in errors
    assert (tmp_path / "study" / "table.csv").exists()
    assert not (tmp_path / "study" / "plot.svg").exists()


def test_seeds_are_added_until_the_intervals_are_narrow(run, study, tmp_path):
    status, output, _ = run(study, "--until-ci", 0.3, "--jobs", 1)
    assert status == 0
    with (tmp_path / "study" / "table.csv").open() as file:
        rows = [each for each in csv.DictReader(file) if (each["kind"], each["hops"]) == ("update", "2")]
    assert {each["seeds"] for each in rows if each["link.loss"] == "0.0"} == {"2"}
    assert max(int(each["seeds"]) for each in rows) > 2
    assert all(float(each["share_ci95"]) <= 0.3 for each in rows)
    assert output.startswith(f"{sum(int(each['seeds']) for each in rows)} of ")


def test_confidence_intervals():
    # By hand: sd of 1, 2, 3, 4, 5 is sqrt(2.5); t(0.975, 4) = 2.776.
    found = Estimate.of([1.0, 2.0, 3.0, 4.0, 5.0])
    assert found.mean == 3
    assert found.half == pytest.approx(2.776 * math.sqrt(2.5 / 5))
    assert found.text(1) == "3.0 +- 2.0"
    assert Estimate.of([2.0]).text(2) == "2.00"
    assert Estimate.of([]) is None
    assert Estimate.of([0.0, 1.0] * 50).half == pytest.approx(1.959964 * statistics.stdev([0.0, 1.0] * 50) / 10)


def test_invalid_studies_are_refused(run, study, tmp_path):
    for sweep, problem in (
        (None, "sweep: a study needs this table"),
        ({"link.loss": 0.1}, "sweep.link.loss: must be a list of at least one value"),
        ({"seeds": 0}, "sweep.seeds: must be an integer of at least 1, not 0"),
        ({"compare": "b", "a": [1]}, "sweep.compare: 'b' is not one of the keys a"),
        ({"zipped": 1}, "sweep.zipped: must be true or false"),
        ({"zipped": True, "a": [1], "b": [1, 2]}, "zipped lists must have the same length"),
        ({"a": list(range(2000)), "b": list(range(2000))}, "more than 1,000,000 runs"),
    ):
        with pytest.raises(ScenarioError, match=problem):
            study_from({} if sweep is None else {"sweep": sweep}, tmp_path, "study")
    study.write_text(STUDY.replace("0.4]", "4.0]"))
    status, _, errors = run(study)
    assert status == 2
    assert "study.toml (link.loss = 4.0, events.*.repetitions = 1): link: " in errors
    assert run(tmp_path / "none.toml")[0] == 2
