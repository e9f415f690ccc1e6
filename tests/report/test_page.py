"""dcp-codec report: the page says what was sent, needs nothing else, and nothing is too odd for it."""

from __future__ import annotations

import json
import math
import os
import re
import shlex
import subprocess
import sys
from collections.abc import Callable
from itertools import combinations
from typing import Any, NamedTuple

import numpy as np
import pytest
from bokeh.plotting import figure
from dcp_tables.report import analysis, variables
from dcp_tables.report.chapter import chapter
from dcp_tables.report.chart import Plot, scale
from dcp_tables.report.page import Chapter, render
from dcp_tables.report.recorded import gather

from dcp_codec import get_codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.cli import main
from dcp_codec.common.pages.colours import SCHEMES, SYMBOLS
from dcp_codec.framing.envelope import Envelope
from dcp_codec.values import Beacon, BPHeader

from .flights import (
    CAPTURES,
    CODEC,
    OTHER,
    START,
    Page,
    Payload,
    address,
    create,
    gathered,
    record,
    report,
    self_contained,
    steady,
    update,
)

SECTIONS = ("holding", "reactions", "anomalies", "senders", "age", "positions", "variables", "overhead")
HOSTILE = "</svg><script>alert(1)</script>$\\frac$\x1b[31m\N{RIGHT-TO-LEFT OVERRIDE}<img src=http://evil/>"


def contrast(one: str, other: str) -> float:
    """The contrast ratio of two colours (``#rrggbb``) as WCAG 2 defines it: 1 to 21."""
    bright, dim = sorted((_luminance(one), _luminance(other)), reverse=True)
    return (bright + 0.05) / (dim + 0.05)


def _luminance(colour: str) -> float:
    parts = [int(colour[at : at + 2], 16) / 255 for at in (1, 3, 5)]
    red, green, blue = (part / 12.92 if part <= 0.04045 else ((part + 0.055) / 1.055) ** 2.4 for part in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue


class Result(NamedTuple):
    status: int
    err: str


@pytest.fixture
def run(capsys: pytest.CaptureFixture[str]) -> Callable[..., Result]:
    def call(*args: object) -> Result:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main(["report", *map(str, args)])
        err = capsys.readouterr().err
        assert "Traceback" not in err
        return Result(int(stop.value.code or 0), err)

    return call


def items(text: str) -> dict[str, Any]:
    """The plots of a page, as the script of the page gets them."""
    found = re.search(r'<script type="application/json" id="plots">(.*?)</script>', text, re.DOTALL)
    assert found is not None
    plots: dict[str, Any] = json.loads(found[1])
    return plots


def size(drawn: Chapter) -> int:
    """Octets of the page without the library."""
    text = render([drawn])
    return len(json.dumps(items(text)))


def test_page(run, tmp_path):
    page = tmp_path / "out" / "page.html"
    done = run(CAPTURES / "c_latejoin.mcap", "-o", page)
    assert done.status == 0, done.err
    assert [line for line in done.err.splitlines() if not line.startswith("dcp-codec: ")] == []
    text = page.read_text("utf-8")
    found = self_contained(text)
    for section in SECTIONS:
        assert f'id="{section}-1"' in text
    # The section on held values comes first.
    sections = [attrs["id"] for tag, attrs in found.elements if tag == "section"]
    assert sections == [f"{section}-1" for section in SECTIONS]
    plots = items(text)
    assert found.many("figure") == len(plots) == 11
    assert "hop" not in re.sub(r"not a number of hops", "", found.text)
    assert len(text) < 2_000_000


@pytest.mark.part("tables")
def test_every_colour_of_a_plot_is_one_of_the_scheme():
    """Or the script of the page could not exchange it."""
    text = json.dumps(items(render([chapter(gather(str(CAPTURES / "c_latejoin.mcap"), "cpp-2.0", None))])))
    assert set(re.findall(r"#[0-9a-f]{6}\b", text)) <= {light for light, _ in SCHEMES.values()}


class TestAccess:
    @pytest.mark.parametrize("scheme", [0, 1], ids=["light", "dark"])
    @pytest.mark.parametrize("role", ["ink", "soft", "fail", "accent", *(f"s{number}" for number in range(10))])
    def test_contrast(self, role, scheme):
        for background in ("paper", "card", "code"):
            assert contrast(SCHEMES[role][scheme], SCHEMES[background][scheme]) >= 4.5, background

    def test_contrast_is_that_of_wcag(self):
        assert contrast("#000000", "#ffffff") == pytest.approx(21)
        assert contrast("#777777", "#ffffff") == pytest.approx(4.48, abs=0.01)

    def test_colours_can_be_exchanged_and_symbols_distinguished(self):
        for scheme in zip(*SCHEMES.values(), strict=True):
            assert all(a != b for a, b in combinations(scheme, 2))
        assert len({marker for marker, _ in SYMBOLS}) == len({symbol for _, symbol in SYMBOLS}) == 10

    @pytest.mark.part("tables")
    def test_structure(self):
        text = render([chapter(gather(str(CAPTURES / "c_latejoin.mcap"), "cpp-2.0", None))])
        page = Page(text)
        links = [attrs["href"] for tag, attrs in page.elements if tag == "a"]
        assert links == ["#main", *(f"#{section}-0" for section in SECTIONS)]
        assert page.many("caption") == page.many("table") > 5
        assert page.many("th") > 20
        assert all("scope" in attrs for tag, attrs in page.elements if tag == "th")
        scrolling = [attrs for tag, attrs in page.elements if attrs.get("class") == "wide"]
        assert all(attrs["tabindex"] == "0" and attrs["aria-label"] for attrs in scrolling)
        assert "scroll sideways for more" in text
        # Each plot says in words what it shows.
        assert page.text.count("In words") >= 8


@pytest.mark.part("tables")
class TestTwoFlights:
    def test_side_by_side(self, run, tmp_path):
        page = tmp_path / "page.html"
        one = record(tmp_path / "one.pcap", steady(1, 10))
        two = record(tmp_path / "two.pcap", steady(1, 20, skipped=range(5, 25)) + steady(2, 20))
        assert run(one, two, "-p", "dcp-2.0", "--out", page).status == 0
        text = page.read_text("utf-8")
        found = self_contained(text)
        assert "The recordings compared" in found.text
        assert re.search(r"beacons lost\s+0 \(0 %\)\s+20 \(5 %\)", found.text)
        assert [attrs["id"] for tag, attrs in found.elements if tag == "section" and "id" in attrs][:4] == [
            "holding-1", "holding-2", "reactions-1", "reactions-2",
        ]  # fmt: skip
        plots = items(text)
        assert {plot["group"] for plot in plots.values()} == {"all"}
        # The same axes, so that the pictures can be compared.
        assert axis(plots["01-age"], "x_range") == axis(plots["02-age"], "x_range")
        assert axis(plots["01-age"], "x_range")["end"] > 19_900
        assert axis(plots["01-age"], "y_range") == axis(plots["02-age"], "y_range")

    def test_one_of_two_recordings_is_empty(self, tmp_path):
        one, two = record(tmp_path / "one.pcap", steady(1, 2)), record(tmp_path / "two.pcap", [])
        text = render([chapter(gathered(path), number) for number, path in enumerate((one, two), start=1)])
        assert "It has no frames at all." in self_contained(text).text


def axis(plot: dict[str, Any], name: str) -> dict[str, Any]:
    """The range of an axis."""
    (root,) = plot["item"]["doc"]["roots"]
    found: dict[str, Any] = root["attributes"][name]["attributes"]
    return found


@pytest.mark.part("tables")
class TestLongRecordings:
    def test_numbers_rise_and_the_number_of_drawn_points_is_stated(self, tmp_path):
        """The aliasing of a recording of hours, from a hundred thousand updates of an 8-bit number."""
        recorded = gathered(record(tmp_path / "a.pcap", [(0.0, 1, 0, (create(7, 1, b"a"),)), (1.0, 1, 1, OTHER)]))
        many = 100_000
        values = recorded.tables["values"]
        for column in values:
            values[column] = np.resize(values[column], many)
        values["frame"] = np.arange(1, many + 1)
        values["time"] = START + np.arange(many) * 180_000_000
        values["seqno"] = np.arange(many) % 256
        values["creation"][1:] = -1
        recorded.tables["beacons"]["time"] = START + np.array([0, many * 180_000_000])
        drawn = chapter(recorded)
        plot = next(plot for plot in drawn.plots if plot.name.endswith("seqno"))
        source = next(each for each in plot.figure.renderers if each.data_source.name == "variable 7").data_source
        count = source.data["y"]
        assert (np.diff(count) > 0).all()
        assert count[-1] == many - 1
        assert count.size < 10_000
        assert f"1 of {many / count.size:.3g} drawn" in plot.caption
        assert size(drawn) < 500_000

    def test_a_fall_of_one_report_is_on_the_plot_of_heights(self, tmp_path):
        recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3)))
        many = 200_000
        reports = recorded.tables["srp"]
        for column in reports:
            reports[column] = np.resize(reports[column], many)
        reports["time"] = START + np.arange(many, dtype=np.int64) * 100_000_000
        reports["z"] = 100 + np.sin(np.arange(many) / 50)
        reports["z"][123_456] = 0.0
        drawn = chapter(recorded)
        plot = next(plot for plot in drawn.plots if plot.name.endswith("height"))
        source = plot.figure.renderers[0].data_source
        assert source.data["y"].min() == 0.0
        assert "drawn: the first, last, minimum and maximum" in plot.caption

    def test_the_page_stays_small(self, tmp_path):
        recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3) + steady(2, 3)))
        for table in recorded.tables.values():
            repeated = {column: np.tile(values, 2000) for column, values in table.items()}
            if repeated["time"].size:
                repeated["time"] = START + np.arange(repeated["time"].size, dtype=np.int64) * 1_000_000_000
            table.update(repeated)
        assert size(chapter(recorded)) < 900_000


@pytest.mark.part("tables")
class TestCommands:
    def test_each_anomaly_has_one_that_works(self, run, tmp_path, capsys):
        path = record(tmp_path / "a b.pcap", steady(1, 3, skipped=[7, 8]), damaged=[0.55])
        section = next(each for each in chapter(gathered(path)).sections if each.title == "Anomalies")
        commands = [row[-1].text for row in section.tables[-1].rows]
        assert len(commands) == 2
        for command in commands:
            done = subprocess.run(
                [sys.executable, "-c", "from dcp_codec.cli import main; main()", *shlex.split(command)[1:]],
                capture_output=True, text=True, check=False,
            )  # fmt: skip
            assert done.returncode in (0, 1)
            assert re.search(rf"(?i)frame {re.findall(r'--frames ([0-9]+)', command)[0]}\b", done.stdout), done.stdout

    def test_a_pipe_cannot_be_read_again(self, tmp_path):
        recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3, skipped=[7])))
        recorded.outcome.path = "-"
        assert "dcp-codec decode" not in Page(render([chapter(recorded)])).text


def test_hostile_text_stays_text(tmp_path):
    path = record(tmp_path / "a<b>.pcap", [(0.0, 1, 0, (create(7, 1, b"1", HOSTILE),)), (1.0, 2, 0, (report(2, 0),))])
    text = render([chapter(gathered(path))])
    page = self_contained(text)
    assert "<script>alert(1)</script>$\\frac$\\x1b[31m\\u202e<img" in page.text
    assert "\x1b" not in text
    assert "a<b>.pcap" in page.text


def test_hostile_names_stay_text(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 2) + steady(2, 2)))
    recorded.nodes[:] = ["</script><script>1</script>", "$$\\frac{1}{2}$$@{x}"]
    text = render([chapter(recorded)])
    page = self_contained(text)
    assert "</script><script>1</script>" in page.text
    # No text that Bokeh would process as TeX, with a library loaded from elsewhere.
    assert "$$" not in json.dumps(items(text))


@pytest.mark.part("tables")
def test_many_senders_and_variables_are_bounded(tmp_path):
    sent = [(n / 10, node, n, (report(node, n),)) for node in range(1, 24) for n in range(3 + node)]
    sent += [(node / 10, 1, 100 + node, (create(node, 1, b"12"),)) for node in range(1, 24)]
    drawn = chapter(gathered(record(tmp_path / "a.pcap", sorted(sent, key=lambda each: each[0]))))
    page = self_contained(render([drawn]))
    assert "The 20 senders with most beacons are drawn; 3 more sent " in page.text
    assert "The 20 variables with most values are drawn; 3 more have 3 values." in page.text
    assert size(drawn) < 2_500_000


@pytest.mark.part("tables")
def test_as_many_senders_as_beacons(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3)))
    many = 20_000
    recorded.nodes += [str(number) for number in range(many)]
    for table in recorded.tables.values():
        table.update({name: np.resize(values, many) for name, values in table.items() if values.size})
        if table["time"].size:
            table["node"] = np.arange(many, dtype=np.int32)
    page = Page(render([chapter(recorded)]))
    assert "19,980 more sent 19,980 received beacons" in page.text


@pytest.mark.part("tables")
def test_invalid_positions(tmp_path):
    odd = [(math.nan, 1.0, 1.0), (1e300, 1.0, 1.0), (1.0, math.inf, 1.0), (1.0, 1.0, 2.0), (2.0, 1.0, -math.inf)]
    sent = [(n / 10, 1, n, (report(1, n, *place),)) for n, place in enumerate(odd)]
    page = Page(render([chapter(gathered(record(tmp_path / "a.pcap", sent)))]))
    assert "4 of 5 state reports have coordinates that are not numbers or out of range" in page.text


def test_positions_that_hardly_differ(tmp_path):
    sent = [(n / 10, 1, n, (report(1, n, 1e-111 * n, 9.9e7 + 1e-8 * n, 5e-324 * n),)) for n in range(3)]
    assert self_contained(render([chapter(gathered(record(tmp_path / "a.pcap", sent)))]))


def test_time_that_goes_backwards(tmp_path):
    sent = [(5.0, 1, 0, (create(7, 1, b"1"),)), (4.0, 2, 0, (create(7, 1, b"1"),))]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    for name, table in recorded.tables.items():
        if name in ("beacons", "values"):
            table["time"] = table["time"][::-1].copy()
            table["node"] = table["node"][::-1].copy()
    values, passed = variables.dissemination(recorded, analysis.time_of(recorded))
    assert passed.delay.tolist() == [-1.0]
    assert values.from_producer.tolist() == [True]
    assert self_contained(render([chapter(recorded)]))


@pytest.mark.part("tables")
def test_a_clock_that_was_set_back_is_reported(tmp_path):
    path = tmp_path / "a.pcap"
    envelope = Envelope(CODEC.profile.link)
    with create_capture(path) as writer:
        for number, seconds in enumerate((10, 11, 12, 3, 4), start=1):
            data = envelope.frame(CODEC.encode(Beacon(BPHeader(address(1), number, 1), OTHER)), address(1))
            writer.write(Frame(number, START + seconds * 1_000_000_000, data, len(data)))
    recorded = gathered(path)
    time, steps = analysis.time_of(recorded), analysis.steps_of(recorded)
    assert steps.back.tolist() == [0, 0, 0, 9_000_000_000, 0]
    (odd,) = analysis.worst(recorded, time, steps, 10)
    assert (odd.kind, odd.frame, odd.words) == (
        "time goes back", 4, "recorded 9.000000 s before the sender's previous beacon",
    )  # fmt: skip
    text = self_contained(render([chapter(recorded)])).text
    assert "Time goes back in this recording" in text
    assert "time goes back (1)" in json.dumps(items(render([chapter(recorded)])))


def test_one_beacon_has_no_rate(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", [(0.0, 1, 5, OTHER)]))
    (one,) = analysis.senders_of(recorded, analysis.time_of(recorded), analysis.steps_of(recorded))
    assert one.rate is None
    assert "Time goes back" not in self_contained(render([chapter(recorded)])).text


@pytest.mark.part("tables")
def test_damage_is_shown(run, tmp_path):
    path = record(tmp_path / "a.pcap", steady(1, 3, skipped=[7, 8]), damaged=[0.55])
    done = run(path, "-o", tmp_path / "a.html", "--profile", "dcp-2.0")
    assert done.status == 1
    assert "1 of 29 DCP frames are malformed" in done.err
    text = (tmp_path / "a.html").read_text("utf-8")
    page = self_contained(text)
    assert "2 missing before sequence number 9" in page.text
    assert "malformed (1)" in json.dumps(items(text))
    path.write_bytes(path.read_bytes()[:-5])
    done = run(path, "-o", tmp_path / "a.html", "--profile", "dcp-2.0", "--force")
    assert done.status == 2
    assert path.name in done.err


@pytest.mark.part("tables")
@pytest.mark.parametrize(
    ("sent", "damaged", "words"),
    [
        ([], [1.0, 2.0], ("There is no well-formed beacon.", "no state reports", "malformed")),
        (
            [(0.0, 1, 5, (Payload(99, b"data"),))],
            [],
            ("no positions", "No node sent a record", "None: there is no malf"),
        ),
        ([(0.0, 1, 5, (report(1, 1),))], [], ("reception cannot be inferred", "No node sent a record")),
        ([(0.0, 1, 5, (report(9, 1),))], [], ("reception cannot be inferred",)),
        ([(0.0, 1, 5, (update(3, 1, b""),))], [], ("not heard", "there are no delays")),
    ],
    ids=["malformed only", "other payloads", "one report", "about another", "empty value without producer"],
)
def test_little_to_draw(sent, damaged, words, tmp_path):
    page = self_contained(render([chapter(gathered(record(tmp_path / "a.pcap", sent, damaged)))]))
    for each in words:
        assert each in page.text


def test_a_pipe_of_other_traffic(run, tmp_path, monkeypatch):
    path = tmp_path / "a.pcap"
    with create_capture(path) as writer:
        writer.write(Frame(1, START, b"\xff" * 12 + b"\x08\x06" + bytes(46), 60))
    with path.open("rb") as pipe:
        monkeypatch.setattr(sys, "stdin", type("Pipe", (), {"buffer": pipe, "isatty": lambda self: False})())
        told = run("-", "-p", "dcp-2.0", "-o", tmp_path / "a.html").err
    assert "no DCP frames under EtherType 0x4953; there is: 1 other frames." in told
    assert "All 1 frames are other traffic." in Page((tmp_path / "a.html").read_text()).text


def test_nothing_to_draw(run, tmp_path):
    done = run(record(tmp_path / "none.pcap", []), "-o", tmp_path / "a.html", "--profile", "dcp-2.0")
    assert "no DCP frames" in done.err
    text = (tmp_path / "a.html").read_text("utf-8")
    assert "It has no frames at all." in Page(text).text
    assert "data-plot=" not in text


@pytest.mark.parametrize("profile", ["sim-1.0", "student-2024"])
def test_profiles_without_optional_fields(profile, tmp_path):
    codec = get_codec(profile)
    recorded = gather(str(record(tmp_path / "a.pcap", [])), profile, None)
    assert recorded.outcome.profile == codec.profile.name
    assert self_contained(render([chapter(recorded)]))


@pytest.mark.part("tables")
def test_several_recordings_are_chapters(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    paths = [record(tmp_path / f"{node}.pcap", steady(node, 2)) for node in (1, 2, 3)]
    assert run(*paths, tmp_path / "none.pcap", "-p", "dcp-2.0").status == 2
    text = (tmp_path / "report.html").read_text("utf-8")
    page = self_contained(text)
    assert page.many("article") == 3
    assert "The recordings compared" in page.text
    assert {plot["group"] for plot in items(text).values()} == {"01", "02", "03"}


@pytest.mark.part("tables")
def test_refusals(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = record(tmp_path / "a.pcap", steady(1, 1))
    assert run(path, "-p", "dcp-2.0").status == 0
    kept = (tmp_path / "a.html").read_bytes()
    cases: list[tuple[tuple[Any, ...], str]] = [
        ((path, "-p", "dcp-2.0"), "a.html: exists; give --force to replace it"),
        ((path, "-p", "dcp-9.9", "--force"), "dcp-9.9"),
        ((tmp_path / "none.pcap", "-o", "b.html"), "none.pcap"),
        (("*.nonsense", "-o", "b.html"), "no file matches this pattern"),
        (("-", "-o", "b.html"), "name the --profile"),
        ((path, "-p", "dcp-2.0", "-o", path / "x.html"), "a.pcap"),
        ((path, "-p", "dcp-2.0", "-o", "pipe", "--force"), "pipe: is not a regular file and will not be replaced"),
    ]
    os.mkfifo("pipe")
    for args, words in cases:
        done = run(*args)
        assert done.status == 2, args
        assert words in done.err
    assert (tmp_path / "a.html").read_bytes() == kept
    assert (tmp_path / "pipe").is_fifo()
    # The same recording, the same octets.
    assert run(path, "-p", "dcp-2.0", "--force").status == 0
    assert (tmp_path / "a.html").read_bytes() == kept
    assert sorted(each.name for each in tmp_path.iterdir()) == ["a.html", "a.pcap", "pipe"]


def test_memory_is_bounded(tmp_path):
    """The number of stored rows is bounded, and the page reports the limit."""
    path = record(tmp_path / "a.pcap", steady(2, 20))
    whole = gather(str(path), "dcp-2.0", None)
    assert whole.outcome.problems == []
    # Blocks are taken whole: with one block all of it is there, and a note says that there may be more.
    cut = gather(str(path), "dcp-2.0", None, most=1)
    assert cut.outcome.frames == whole.outcome.frames
    (problem,) = cut.outcome.problems
    assert f"only the first {cut.outcome.frames:,} frames are in this report" in problem
    assert problem in Page(render([chapter(cut)])).text


def test_the_page_is_bounded(run, tmp_path):
    for number in range(21):
        (tmp_path / f"{number}.pcap").write_bytes(b"")
    done = run(tmp_path, "-o", tmp_path / "a.html")
    assert done.status == 2
    assert "a page holds 20 recordings, and these are 21" in done.err


def test_missing_package_is_named(run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "bokeh", None)
    for module in [each for each in sys.modules if each.startswith(("dcp_tables.report.", "bokeh."))]:
        monkeypatch.delitem(sys.modules, module)
    done = run(record(tmp_path / "a.pcap", []), "-o", tmp_path / "a.html")
    assert done.status == 2
    assert "bokeh is not installed: pip install 'dcp-conformance-tables[report]'" in done.err


@pytest.mark.parametrize("from_zero", [False, True])
@pytest.mark.parametrize("limits", [(0.0, 0.0), (0.0, 0.0004), (-0.001, 0.001), (12.5, 12.5), (4e7, 4e7), (0.0, 250.0)])
def test_labels_of_three_decimals_distinguish_the_ticks_of_every_axis(limits, from_zero):
    plot = Plot("a", "A", "", "", figure(), limits, over_time=True, from_zero=from_zero)
    scale(plot, limits)
    start, end = plot.figure.y_range.start, plot.figure.y_range.end
    assert start <= limits[0]
    assert limits[1] <= end
    assert end - start >= 0.01
    if from_zero and limits[0] >= 0:
        assert start >= 0
