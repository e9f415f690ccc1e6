"""``dcp-node simulate``, and what ``dcp-node testbed`` says before it needs any rights."""

from __future__ import annotations

import csv
import json
import statistics
import subprocess
import sys
from pathlib import Path

import pytest

from dcp_stack.cli import main

LINE = Path(__file__).parents[2] / "examples" / "line.toml"


@pytest.fixture
def run(capsys):
    def call(*arguments: object) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            main([str(each) for each in arguments])
        shown = capsys.readouterr()
        return ended.value.code, shown.out, shown.err

    return call


def test_a_scenario_as_text(run):
    status, output, errors = run("simulate", LINE)
    assert (status, errors) == (0, "")
    assert output.startswith("five in a line: 5 nodes, dcp-2.0, 24 s, simulate, seed 1\n")
    assert "node 4 is switched on" in output
    assert "times real time" in output
    assert "NOT MET" not in output


def test_json_and_the_same_digest_for_the_same_seed(run):
    first, second, other = (
        json.loads(run("simulate", "-n", 9, "--topology", "grid", "--duration", 8, "--json", "--seed", seed)[1])
        for seed in (5, 5, 6)
    )
    assert first["digest"] == second["digest"] != other["digest"]
    assert first["met"] is True
    assert first["speed_up"] > 0
    assert [each["node"] for each in first["traffic"]] == list(range(9))


def test_the_rows_of_values_are_those_of_the_report(run, tmp_path):
    path = tmp_path / "values.csv"
    arguments = ("simulate", "-n", 4, "--topology", "line", "--duration", 20, "--loss", 0.3, "--json")
    status, output, errors = run(*arguments, "--values", path)
    assert (status, errors) == (0, "")
    rows = list(csv.DictReader(path.read_text().splitlines()))
    values = json.loads(output)["values"]
    assert len(rows) == values["due"]
    arrived = [each for each in rows if each["arrived"]]
    assert len(arrived) == values["received"]
    for delay in json.loads(output)["delays"]:
        kind = [
            each
            for each in arrived
            if each["hops"] == str(delay["hops"]) and (each["number"] == "0") == (delay["kind"] == "creation")
        ]
        assert len(kind) == delay["received"]
        assert statistics.fmean(float(each["delay_ms"]) for each in kind) == pytest.approx(delay["mean_ms"])
    assert json.loads(run(*arguments)[1])["digest"] == json.loads(output)["digest"]


@pytest.mark.part("tables")
def test_the_query_of_the_page_gives_the_mean_age(run, tmp_path, monkeypatch):
    """A value every 5 s that arrives after a delay D has a mean age of 2.5 s + D."""
    duckdb = pytest.importorskip("duckdb")
    monkeypatch.chdir(tmp_path)
    assert run("simulate", "-n", 3, "--topology", "line", "--duration", 400, "--values", "values.parquet")[0] == 0
    page = (LINE.parents[1] / "docs" / "scenarios.md").read_text()
    query = page.partition("```sql\n")[2].partition("```")[0]
    mean = "select hops, avg(delay_ms) / 1000 from 'values.parquet' where number > 0 group by hops order by hops"
    for (hops, age), (same, delay) in zip(duckdb.sql(query).fetchall(), duckdb.sql(mean).fetchall(), strict=True):
        assert hops == same
        assert age == pytest.approx(2.5 + delay, abs=0.05)


def test_a_file_of_values_is_csv_or_parquet(run, tmp_path):
    status, _, errors = run("simulate", "-n", 2, "--values", tmp_path / "values.txt")
    assert status == 2
    assert "ends with .csv or .parquet" in errors


def test_the_counts_of_delivered_and_lost_beacons_add_up(run):
    # Two that hear each other; the medium has delivered all, lost all, or something in between.
    for loss in (0, 0.5, 1):
        arguments = ("simulate", "-n", 2, "--duration", 8, "--loss", loss)
        report = json.loads(run(*arguments, "--json")[1])
        sent = sum(each["beacons_sent"] for each in report["traffic"])
        received = sum(each["beacons_received"] for each in report["traffic"])
        lost = round(report["expected"] * report["shares"].get("lost", 0))
        assert report["expected"] == sent == received + lost
        (medium,) = (line for line in run(*arguments)[1].splitlines() if line.startswith("medium"))
        assert medium.startswith(f"medium     {sent} deliveries to neighbours: {received} delivered (")
        assert (f", {lost} lost (" in medium) == (lost > 0)


def test_options_replace_what_the_scenario_says(run):
    status, output, _ = run("simulate", LINE, "--loss", 1, "--json")
    report = json.loads(output)
    assert status == 1
    assert report["shares"]["lost"] == 1
    assert not report["met"]
    # Nodes 5 and 6 hear their neighbours; the line is extended.
    assert len(json.loads(run("simulate", LINE, "--nodes", 7, "--json")[1])["traffic"]) == 7


def test_recordings(run, tmp_path):
    status, _, _ = run(
        "simulate", "-n", 3, "--duration", 3, "--record", tmp_path / "new", "--record-medium", tmp_path / "all.mcap"
    )
    assert status == 0
    assert sorted(path.name for path in (tmp_path / "new").iterdir()) == ["node-0.mcap", "node-1.mcap", "node-2.mcap"]
    assert (tmp_path / "all.mcap").stat().st_size > 1000


def test_a_recording_that_ends_early_is_reported(tmp_path):
    """Files may become so long and no longer: as on a full disk."""
    # Without -B the interpreter would leave compiled modules that are cut off, for all who come after.
    simulate = [sys.executable, "-B", "-m", "dcp_stack.cli", "simulate", "-n", "4", "--duration", "30"]
    limited = ["sh", "-c", 'ulimit -f 20; exec "$@"', "sh", *simulate, "--record-medium", str(tmp_path / "all.mcap")]
    done = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert f"{tmp_path}/all.mcap: cannot be written: File too large" in done.stderr
    # The rest is there.
    assert "met      no node raises an exception" in done.stdout


def test_a_network_of_one_node(run):
    assert run("simulate", "-n", 1, "--duration", 2)[0] == 0


@pytest.mark.parametrize("what", ["simulate", "testbed"])
@pytest.mark.parametrize(
    ("arguments", "complaint"),
    [
        ([], "give a SCENARIO file or a number of nodes"),
        (["--scenario", "/nowhere.toml"], "/nowhere.toml: cannot be read: No such file"),
        (["2", "--topology", "ring"], "unknown topology 'ring'; expected one of"),
        (["2", "--profile", "dcp-3.0"], "unknown profile 'dcp-3.0'"),
        (["2", "--loss", "2"], "--loss"),
        (["2", "--duration", "0"], "--duration"),
        (["two"], ""),
    ],
)
def test_usage_errors_are_one_line(run, what, arguments, complaint):
    if what == "simulate":
        arguments = [each for each in arguments if each != "--scenario"]
        arguments = ["--nodes", *arguments] if arguments[:1] == ["2"] else arguments
    status, output, errors = run(what, *arguments)
    assert (status, output) == (2, "")
    assert complaint in errors
    assert "Traceback" not in errors


def test_too_many_processes(run):
    status, _, errors = run("testbed", "--scenario", LINE, "--topology", "line", "201")
    assert status == 2
    assert "200" in errors


@pytest.mark.parametrize(
    ("table", "complaint"),
    [
        (
            '[[events]]\nat_s = 1\ndo = "update"\nnode = 0\nvariable = 1\ntext = "a"\nevery_s = 5e-324',
            "every_s: must be finite",
        ),
        (
            '[[events]]\nat_s = 1\ndo = "update"\nnode = 0\nvariable = 1\ntext = "a"\nevery_s = inf',
            "every_s: must be finite",
        ),
        ('[[events]]\nat_s = nan\ndo = "heal"', "at_s: nan is not within"),
        ('[[expect]]\nthat = "converged"\nwithin_s = inf', "within_s: must be finite"),
        ('[[expect]]\nthat = "converged"\nwithin_s = nan', "within_s: must be finite"),
        ('[[expect]]\nthat = "beacon-rate"\nper_s = nan', "per_s: must be finite"),
    ],
)
def test_times_without_end_are_refused_before_anything_is_played(run, tmp_path, table, complaint):
    path = tmp_path / "scenario.toml"
    path.write_text(f"nodes = 2\nduration_s = 3\n{table}\n")
    status, output, errors = run("simulate", path)
    assert (status, output) == (2, "")
    assert complaint in errors
    assert "Traceback" not in errors


def test_a_recording_of_the_medium_claims_nothing_about_losses(run, tmp_path, capsys):
    from dcp_codec.cli import main as codec

    medium, folder = tmp_path / "medium.mcap", tmp_path / "nodes"
    run("simulate", "-n", 2, "--duration", 5, "--loss", 0.5, "--record-medium", medium, "--record", folder)

    def stats(*arguments: object) -> str:
        with pytest.raises(SystemExit):
            codec(["stats", *map(str, arguments)])
        return capsys.readouterr().out

    assert {each["lost"] for each in json.loads(stats(medium, "--format", "json"))["senders"].values()} == {None}
    assert "lost: unknown; this recording has each transmission once" in stats(medium)
    # The recording of a node contains its reception losses.
    own = json.loads(stats(folder / "node-0.mcap", "--format", "json"))["senders"]
    assert own["02:00:00:00:00:00"]["lost"] == 0
    assert own["02:00:00:00:00:01"]["lost"] > 5


@pytest.mark.part("tables")
@pytest.mark.parametrize("vantage", ["medium", "node"])
def test_the_page_of_a_recording_of_the_medium_claims_nothing_about_losses(run, tmp_path, vantage):
    pytest.importorskip("bokeh")
    from dcp_codec.cli import main as codec

    medium, folder, page = tmp_path / "medium.mcap", tmp_path / "nodes", tmp_path / "page.html"
    run("simulate", "-n", 2, "--duration", 5, "--loss", 0.5, "--record-medium", medium, "--record", folder)
    with pytest.raises(SystemExit) as ended:
        codec(["report", str(medium if vantage == "medium" else folder / "node-0.mcap"), "--out", str(page)])
    assert not ended.value.code
    text = page.read_text()
    assert ("Losses are unknown: this recording has each transmission once" in text) == (vantage == "medium")
    assert "No sequence number of a beacon is missing" not in text
    # Where the recording was made is a fact, not a problem.
    assert 'class="notes fail"' not in text


@pytest.mark.part("suite")
def test_the_default_scenario_allows_for_the_number_of_hops(run):
    """Values need 1.5 beacon periods a hop: 5 s are too few for 62 hops, and nothing is amiss."""
    report = json.loads(
        run("simulate", "-n", 60, "--topology", "line", "--duration", 16, "--variables", 1, "--json")[1]
    )
    (expected,) = report["provenance"]["scenario"]["expect"]
    assert expected["within_s"] == pytest.approx(1 + 0.2 * 59)
    assert report["met"]
    # Too short for that: nothing is expected, rather than something that cannot be.
    short = json.loads(run("simulate", "-n", 60, "--topology", "line", "--duration", 8, "--json")[1])
    assert short["provenance"]["scenario"]["expect"] == []


def test_keys_are_set_on_the_command_line(run):
    def scenario(*settings: str) -> dict:
        arguments = [word for each in settings for word in ("--set", each)]
        return json.loads(run("simulate", LINE, "--json", *arguments)[1])["provenance"]["scenario"]

    usual = scenario()
    changed = scenario(
        "link.loss=0.25", "topology=grid:2", "events.*.repetitions=3", "bp.jitter=0", "events.0.at_s=0.5"
    )
    assert changed["link"]["loss"] == 0.25
    assert (changed["topology"]["kind"], changed["topology"]["columns"]) == ("grid", 2)
    assert {each["repetitions"] for each in changed["events"] if each["do"] == "create"} == {3}
    assert changed["bp"]["jitter"] == 0
    assert changed["events"][0]["at_s"] == 0.5 != usual["events"][0]["at_s"]
    assert changed["events"][1:][0]["at_s"] == usual["events"][1:][0]["at_s"]
    default = json.loads(run("simulate", "-n", 2, "--duration", 1, "--set", "seed=7", "--json")[1])
    assert default["seed"] == 7
    for setting, problem in (
        ("link.los=1", "link: unknown key `los`; did you mean loss?"),
        ("events.99.at_s=1", "events.99.at_s: there is no such key in this scenario"),
        ("events.*.nonsense=1", "events.*.nonsense: there is no such key in this scenario"),
        ("link", "'link' is not KEY=VALUE"),
        ("link.loss=much", "Expected `float`, got `str`"),
    ):
        status, _, errors = run("simulate", LINE, "--set", setting)
        assert status == 2, setting
        assert problem in errors, (setting, errors)


def test_an_interrupted_run_reports_what_it_has_measured(run, monkeypatch):
    from dcp_lab.sim.virtual.network import Network

    usual = Network.run_until

    def interrupted(self, end, **more):
        usual(self, end // 2, **more)
        raise KeyboardInterrupt

    monkeypatch.setattr(Network, "run_until", interrupted)
    status, output, _ = run("simulate", LINE)
    assert status == 1
    assert "NOT MET  the run reaches its end: interrupted at 12.000 s; later expectations are not judged" in output
    assert "values     " in output


def test_when_another_implementation_composes_is_reported(run):
    note = "the C++ implementation composes a payload right after the beacon before it"
    settings = ("simulate", LINE, "--set", "profile=cpp-2.0")
    assert note in run(*settings)[1]
    assert note not in run(*settings, "--set", "readings.X54=after-the-beacon")[1]
    assert note not in run("simulate", LINE)[1]


def test_a_trigger_without_effect_is_reported(run):
    note = "bp.triggered has no effect on VarDis"
    settings = ("simulate", LINE, "--set", "bp.triggered=true")
    assert note in run(*settings)[1]
    assert note not in run(*settings, "--set", "readings.X54=after-the-beacon")[1]
