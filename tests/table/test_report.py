"""dcp-codec report: the numbers are those of what was sent, the page needs nothing else, and nothing is too odd."""

from __future__ import annotations

import math
import os
import re
import sys
from collections.abc import Callable, Iterable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from dcp_codec import get_codec
from dcp_codec.capture import Frame, create_capture
from dcp_codec.cli import main
from dcp_codec.envelope import Envelope
from dcp_codec.report import analysis, variables
from dcp_codec.report.easel import short_names
from dcp_codec.report.page import chapter, render
from dcp_codec.report.recorded import Recorded, gather
from dcp_codec.report.series import ordinal, runs, seconds_text, si, thinned
from dcp_codec.values import (
    Beacon,
    BPHeader,
    Container,
    ExtendedSafetyData,
    Payload,
    VarCreate,
    VarSpec,
    VarUpdate,
)

ROOT = Path(__file__).resolve().parents[2]
CAPTURES = ROOT / "captures"
CODEC = get_codec("dcp-2.0")
START = 1_790_000_000_000_000_000
SECTIONS = ("senders", "age", "neighbours", "positions", "variables", "overhead", "anomalies")
OTHER = (Payload(99, b"data"),)
SRP, VARDIS, CREATES, UPDATES = 1, 2, 5, 2
HOSTILE = "</svg><script>alert(1)</script>$\\frac$\x1b[31m\N{RIGHT-TO-LEFT OVERRIDE}<img src=http://evil/>"

Sent = tuple[float, int, int, tuple[Payload, ...]]


def address(node: int) -> bytes:
    return bytes([2, 0, 0, 0, 0, node])


def name(node: int) -> str:
    return address(node).hex(":")


def report(node: int, seqno: int, x: float = 1.0, y: float = 2.0, z: float = 3.0) -> Payload:
    place = CODEC.safety_data_type(x=x, y=y, z=z)
    return Payload(SRP, ExtendedSafetyData(place, address(node), 0, seqno))


def create(variable: int, producer: int, value: bytes, descr: str = "a variable") -> Payload:
    spec = VarSpec(variable, address(producer), 1, descr.encode(), 0, 0)
    return Payload(VARDIS, (Container(CREATES, (VarCreate(spec, VarUpdate(variable, 0, value)),)),))


def update(variable: int, seqno: int, value: bytes) -> Payload:
    return Payload(VARDIS, (Container(UPDATES, (VarUpdate(variable, seqno, value),)),))


def record(path: Path, sent: Iterable[Sent], damaged: Iterable[float] = ()) -> Path:
    """A recording of beacons (seconds, node, sequence number, payloads), and of some that are cut off."""
    envelope = Envelope(CODEC.profile.link)
    frames = []
    for seconds, node, seqno, payloads in sent:
        octets = CODEC.encode(Beacon(BPHeader(address(node), seqno, 1), payloads))
        frames.append((seconds, envelope.frame(octets, address(node))))
    whole = CODEC.encode(Beacon(BPHeader(address(1), 0, 1), (report(1, 0),)))
    frames += [(seconds, envelope.frame(whole[:-9], address(1))) for seconds in damaged]
    with create_capture(path) as writer:
        for number, (seconds, data) in enumerate(sorted(frames), start=1):
            writer.write(Frame(number, START + round(seconds * 1e9), data, len(data)))
    return path


def gathered(path: Path) -> Recorded:
    return gather(str(path), "dcp-2.0", None)


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


class Page(HTMLParser):
    """What is in a page: elements with their attributes, and text outside of scripts and style sheets."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self._inside = ""
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        self._inside = tag

    def handle_endtag(self, tag: str) -> None:
        self._inside = ""

    def handle_data(self, data: str) -> None:
        if self._inside not in ("script", "style"):
            self.text += data

    def many(self, tag: str) -> int:
        return sum(found == tag for found, _ in self.elements)


def self_contained(text: str) -> Page:
    """Nothing in the page is anywhere else, and what it refers to within itself is there, once."""
    page = Page(text)
    assert "://" not in text
    assert re.findall(r"url\((?!#)", text) == []
    assert "@import" not in text
    ids = [attrs["id"] for _, attrs in page.elements if "id" in attrs]
    assert len(ids) == len(set(ids))
    for tag, attrs in page.elements:
        assert tag not in ("link", "img", "iframe", "object", "image")
        assert "src" not in attrs
        assert not any(each.startswith("on") for each in attrs)
        if "href" in attrs:
            assert str(attrs["href"]).startswith("#")
            assert str(attrs["href"])[1:] in ids
    assert set(re.findall(r"url\(#([^)]*)\)", text)) <= set(ids)
    assert page.many("script") == 1
    return page


# -- the numbers --------------------------------------------------------------------------------------------------


def steady(node: int, seconds: float, skipped: Iterable[int] = ()) -> list[Sent]:
    """Ten beacons a second with state reports; without some of the numbers."""
    numbers = sorted(set(range(round(seconds * 10))) - set(skipped))
    return [(n / 10 + node / 1000, node, n, (report(node, n),)) for n in numbers]


def test_beacons_and_loss(tmp_path):
    sent = steady(1, 20, skipped=range(50, 60)) + steady(2, 20)
    sent += [(20.5, 2, 5, (report(2, 1),)), (20.6, 2, 5, (report(2, 1),))]
    recorded = gathered(record(tmp_path / "a.pcap", sent, damaged=[3.0, 4.0]))
    time, steps = analysis.time_of(recorded), analysis.steps_of(recorded)
    one, two = analysis.senders_of(recorded, time, steps)
    assert [recorded.nodes[each.node] for each in (one, two)] == [name(1), name(2)]
    assert (one.beacons, one.lost, one.restarts, one.reports) == (190, 10, 0, 190)
    assert one.loss == pytest.approx(0.05)
    assert (two.beacons, two.lost, two.restarts) == (202, 0, 1)
    times = analysis.anomaly_times(recorded, time, steps)
    assert times["gap"].tolist() == pytest.approx([6.0])
    assert times["restart"].tolist() == pytest.approx([20.499])
    assert times["repetition"].tolist() == pytest.approx([20.599])
    assert times["malformed"].tolist() == pytest.approx([2.999, 3.999])
    kinds = [(each.kind, each.words) for each in analysis.worst(recorded, time, steps, 10)]
    assert ("gap", "10 missing before sequence number 60") in kinds
    assert ("restart", "continues with sequence number 5") in kinds
    assert [kind for kind, _ in kinds].count("malformed") == 2
    rate, loss = analysis.rates(recorded, time, steps, one.node)
    assert float(np.sum(rate) * time.width) == pytest.approx(190)
    lossy = np.flatnonzero(np.nan_to_num(loss) > 0)
    assert lossy.tolist() == [int(time.bins(np.array([START + 6_001_000_000]))[0])]


def test_sequence_numbers_wrap_and_run_per_interface(tmp_path):
    many = 1 << 32
    sent = [(n / 10, 1, (many - 3 + n) % many, (report(1, n),)) for n in range(10) if n != 4]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    assert recorded.modulus == many
    assert analysis.steps_of(recorded).lost.tolist() == [0, 0, 0, 0, 1, 0, 0, 0, 0]
    # The same beacons on a second interface are neither repeated nor lost.
    for table in (recorded.tables["beacons"],):
        for column in table:
            table[column] = np.repeat(table[column], 2)
        table["interface"] = np.tile([0, 1], 9)
    steps = analysis.steps_of(recorded)
    assert int(steps.lost.sum()) == 2
    assert not steps.repeated.any()


def test_age():
    ends = np.linspace(0, 10, 6)
    found = analysis.age(np.array([2.5, 3.0, 7.0]), ends)
    # Not heard before 2.5; 1 s old at 4; 3 at 6; 4 just before 7; 3 at the end.
    assert np.isnan(found[0])
    assert found[1:].tolist() == pytest.approx([1.0, 3.0, 4.0, 3.0])
    assert np.isnan(analysis.age(np.empty(0), ends)).all()


def test_age_of_pairs(tmp_path):
    # Node 1 reports each second, node 2 sends 0.3 s later, and never reports.
    sent = [(float(n), 1, n, (report(1, n),)) for n in range(20)]
    sent += [(n + 0.3, 2, n, (Payload(77, b"x"),)) for n in range(20)]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    nodes = [recorded.nodes.index(name(node)) for node in (1, 2)]
    middle, high = analysis.pair_ages(recorded, analysis.time_of(recorded), nodes)
    assert middle[1, 0] == pytest.approx(0.3)
    assert high[1, 0] == pytest.approx(0.3)
    assert np.isnan([middle[0, 0], middle[0, 1], middle[1, 1]]).all()


def test_dissemination(tmp_path):
    sent = []
    for n in range(4):
        at = 2.0 * n
        said = create(7, 1, b"\x00\x05", HOSTILE) if n == 0 else update(7, n, bytes([1, n]))
        sent += [(at, 1, n, (said,)), (at + 0.1, 2, 2 * n, (said,)), (at + 0.25, 3, n, (said,))]
        # Said again, which is no first time.
        sent.append((at + 0.3, 2, 2 * n + 1, (said,)))
    # Long after, node 3 gives node 2 the first value again: not from the producer.
    again = create(7, 1, b"\x00\x05", HOSTILE)
    sent += [(30.0, 3, 4, (again,)), (30.5, 2, 8, (again,))]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    time = analysis.time_of(recorded)
    values, hops = variables.dissemination(recorded, time)
    assert values.seqno.tolist() == [0, 1, 2, 3, 0]
    assert values.time.tolist() == pytest.approx([0, 2, 4, 6, 30])
    assert values.number.tolist() == [5, 257, 258, 259, 5]
    assert values.from_producer.tolist() == [True] * 4 + [False]
    node = {number: recorded.nodes.index(name(number)) for number in (1, 2, 3)}
    counted = hops.counted
    assert hops.delay[counted & (hops.node == node[2])].tolist() == pytest.approx([0.1] * 4)
    assert hops.delay[counted & (hops.node == node[3])].tolist() == pytest.approx([0.25] * 4)
    assert set(hops.hop[counted & (hops.node == node[3])].tolist()) == {2}
    assert variables.edges(hops) == {(node[1], node[2]): 4, (node[2], node[3]): 4, (node[3], node[2]): 1}
    (line,) = variables.lines(recorded, values, hops, 20)
    assert (line.number, line.values, line.sizes, line.value) == (7, 5, "2", b"\x01\x03")
    assert line.description == HOSTILE
    assert line.median == pytest.approx(0.175)
    assert variables.numeric(values, 7)


def test_octets_are_all_counted():
    recorded = gather(str(CAPTURES / "c_latejoin.mcap"), "cpp-2.0", None)
    beacons = recorded.tables["beacons"]
    parts = {part.name: part.octets for part in analysis.overhead(recorded, analysis.time_of(recorded))}
    assert sum(parts.values()) == int((beacons["octets"] + beacons["around"]).sum())
    containers = recorded.tables["containers"]
    for number, text in enumerate(recorded.contents):
        own = int(containers["octets"][containers["content"] == number].sum())
        if own:
            assert parts[text] == own


def test_small_things():
    assert [seconds_text(each) for each in (0.0351, 2.5, 130, 7300)] == ["35.1 ms", "2.5 s", "2 min 10 s", "2 h 1 min"]
    assert [ordinal(each) for each in (1, 2, 3, 4, 11, 12, 21)] == ["1st", "2nd", "3rd", "4th", "11th", "12th", "21st"]
    assert [si(each) for each in (0, 950, 1500, 2e6, 3e12)] == ["0", "950", "1.5k", "2M", "3T"]
    assert runs(np.array([True, True, False, True])) == [(0, 2), (3, 4)]
    assert thinned(np.arange(10_000), 5).tolist() == [0, 2499, 4999, 7499, 9999]
    short = short_names({0: "02:00:00:00:00:01", 1: "02:00:00:00:01:01", 2: "unknown"})
    assert short == {0: "…00:01", 1: "…01:01", 2: "unknown"}
    assert short_names({0: "aabb01", 1: "aabb02"}) == {0: "…bb01", 1: "…bb02"}


# -- the page -----------------------------------------------------------------------------------------------------


def test_page_and_pictures(run, tmp_path):
    page, folder = tmp_path / "out" / "page.html", tmp_path / "png"
    done = run(CAPTURES / "c_latejoin.mcap", "-o", page, "--png", folder)
    assert done.status == 0, done.err
    assert [line for line in done.err.splitlines() if not line.startswith("dcp-codec: ")] == []
    text = page.read_text("utf-8")
    found = self_contained(text)
    for section in SECTIONS:
        assert f'id="{section}-1"' in text
    assert found.many("figure") == found.many("svg") == 14
    # Every colour is one of the page, so that both schemes can be read.
    assert [attrs for tag, attrs in found.elements if re.search(r"#[0-9a-f]{6}", attrs.get("style") or "")] == []
    for words in ("age of the last report (s)", "beacons per second", "x (m)", "delay (s)", "bit/s", "SUMMARIES"):
        assert words in found.text
    pictures = sorted(folder.iterdir())
    assert len(pictures) == 14
    assert all(picture.read_bytes().startswith(b"\x89PNG") for picture in pictures)
    assert len(text) < 300_000


def test_hostile_text_stays_text(tmp_path):
    path = record(tmp_path / "a<b>.pcap", [(0.0, 1, 0, (create(7, 1, b"1", HOSTILE),)), (1.0, 2, 0, (report(2, 0),))])
    text = render([chapter(gathered(path))])
    page = self_contained(text.replace("http://evil/", "evil"))
    assert "<script>alert(1)</script>$\\frac$\\x1b[31m\\u202e<img" in page.text
    assert "\x1b" not in text
    assert "a<b>.pcap" in page.text


def test_hostile_names_stay_text(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 2) + steady(2, 2)))
    recorded.nodes[:] = ["</text><script>1</script>", '$\U00049610&"']
    drawn = chapter(recorded)
    page = self_contained(render([drawn]))
    assert "</text><script>1</script>" in page.text
    assert all("<script" not in plot.svg for plot in drawn.plots)


def test_many_senders_and_variables_are_bounded(tmp_path):
    sent = [(n / 10, node, n, (report(node, n),)) for node in range(1, 24) for n in range(3 + node)]
    sent += [(node / 10, 1, 100 + node, (create(node, 1, b"12"),)) for node in range(1, 24)]
    drawn = chapter(gathered(record(tmp_path / "a.pcap", sorted(sent, key=lambda each: each[0]))))
    page = self_contained(render([drawn]))
    assert "The 20 senders with most beacons are drawn; 3 more sent " in page.text
    assert "The 20 variables with most values are drawn; 3 more have 3 values." in page.text
    assert sum(len(plot.svg) for plot in drawn.plots) < 1_500_000


def test_as_many_senders_as_beacons(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3)))
    many = 20_000
    recorded.nodes += [str(number) for number in range(many)]
    for table in recorded.tables.values():
        table.update({name: np.resize(values, many) for name, values in table.items() if values.size})
        if table["time"].size:
            table["node"] = np.arange(many, dtype=np.int32)
    page = Page(render([chapter(recorded)]))
    assert "19,980 more sent 19,980 beacons" in page.text


def test_long_recordings_are_thinned(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 3) + steady(2, 3)))
    for table in recorded.tables.values():
        repeated = {column: np.tile(values, 2000) for column, values in table.items()}
        if repeated["time"].size:
            repeated["time"] = START + np.arange(repeated["time"].size, dtype=np.int64) * 1_000_000_000
        table.update(repeated)
    assert sum(len(plot.svg) for plot in chapter(recorded).plots) < 500_000


def test_positions_that_are_none(tmp_path):
    odd = [(math.nan, 1.0, 1.0), (1e300, 1.0, 1.0), (1.0, math.inf, 1.0), (1.0, 1.0, 2.0), (2.0, 1.0, -math.inf)]
    sent = [(n / 10, 1, n, (report(1, n, *place),)) for n, place in enumerate(odd)]
    page = Page(render([chapter(gathered(record(tmp_path / "a.pcap", sent)))]))
    assert "4 of 5 state reports have coordinates that are no numbers or beyond all bounds" in page.text


def test_positions_that_hardly_differ(tmp_path):
    sent = [(n / 10, 1, n, (report(1, n, 1e-111 * n, 9.9e7 + 1e-8 * n, 5e-324 * n),)) for n in range(3)]
    assert self_contained(render([chapter(gathered(record(tmp_path / "a.pcap", sent)))]))


def test_time_that_goes_backwards(tmp_path):
    sent = [(5.0, 1, 0, (create(7, 1, b"1"),)), (4.0, 2, 0, (create(7, 1, b"1"),))]
    recorded = gathered(record(tmp_path / "a.pcap", sent))
    for name, table in recorded.tables.items():
        if name in ("beacons", "said"):
            table["time"] = table["time"][::-1].copy()
            table["node"] = table["node"][::-1].copy()
    values, hops = variables.dissemination(recorded, analysis.time_of(recorded))
    assert hops.delay.tolist() == [-1.0]
    assert values.from_producer.tolist() == [True]
    assert self_contained(render([chapter(recorded)]))


def test_a_clock_that_was_set_back_is_told(tmp_path):
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
        "time goes back", 4, "recorded 9.000000 s earlier than the sender's beacon before",
    )  # fmt: skip
    text = self_contained(render([chapter(recorded)])).text
    assert "Time goes back in this recording" in text
    assert "time goes back (1)" in text


def test_a_node_that_was_away_for_long_has_lost_beacons(tmp_path):
    sent = [(0.0, 1, 5, OTHER), (300.0, 1, 3005, OTHER), (300.1, 1, 3, OTHER), (300.2, 1, 2**31 + 3, OTHER)]
    steps = analysis.steps_of(gathered(record(tmp_path / "a.pcap", sent)))
    assert steps.lost.tolist() == [0, 2999, 0, 0]
    assert steps.restart.tolist() == [False, False, True, True]


def test_one_beacon_has_no_rate(tmp_path):
    recorded = gathered(record(tmp_path / "a.pcap", [(0.0, 1, 5, OTHER)]))
    (one,) = analysis.senders_of(recorded, analysis.time_of(recorded), analysis.steps_of(recorded))
    assert one.rate is None
    assert "Time goes back" not in self_contained(render([chapter(recorded)])).text


def test_rows_of_many_senders_tell_their_shades_apart(tmp_path):
    sent = [(n / 10 + node / 1000, node, n, (report(node, n),)) for node in range(1, 13) for n in range(40)]
    text = render([chapter(gathered(record(tmp_path / "a.pcap", sent)))])
    heard = next(svg for svg in re.findall(r"<figure.*?</figure>", text, re.DOTALL) if "Beacons heard" in svg)
    legend = re.findall(r"opacity: ([0-9.]+)", heard[heard.index("time since the first frame") :])
    assert legend[1:] == ["0.296", "0.472", "0.648", "0.824", "1"]  # the first is that of the axis
    lost = next(svg for svg in re.findall(r"<figure.*?</figure>", text, re.DOTALL) if "Beacons lost" in svg)
    assert ">none<" in lost


def test_damage_is_shown(run, tmp_path):
    path = record(tmp_path / "a.pcap", steady(1, 3, skipped=[7, 8]), damaged=[0.55])
    done = run(path, "-o", tmp_path / "a.html", "--profile", "dcp-2.0")
    assert done.status == 1
    assert "1 of 29 DCP frames are malformed" in done.err
    page = self_contained((tmp_path / "a.html").read_text("utf-8"))
    assert "2 missing before sequence number 9" in page.text
    assert "malformed (1)" in page.text
    path.write_bytes(path.read_bytes()[:-5])
    done = run(path, "-o", tmp_path / "a.html", "--profile", "dcp-2.0", "--force")
    assert done.status == 2
    assert path.name in done.err


@pytest.mark.parametrize(
    ("sent", "damaged", "words"),
    [
        ([], [1.0, 2.0], ("There is no well-formed beacon.", "no state reports", "malformed")),
        (
            [(0.0, 1, 5, (Payload(99, b"data"),))],
            [],
            ("no positions", "Nobody said anything", "None: there is no malf"),
        ),
        ([(0.0, 1, 5, (report(1, 1),))], [], ("No node passed on", "Nobody said anything")),
        ([(0.0, 1, 5, (report(9, 1),))], [], ("No node passed on",)),
        ([(0.0, 1, 5, (update(3, 1, b""),))], [], ("not heard", "there are no delays")),
    ],
    ids=["malformed only", "other payloads", "one report", "about another", "empty value of nobody"],
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
    assert "All 1 are other traffic." in Page((tmp_path / "a.html").read_text()).text


def test_nothing_to_draw(run, tmp_path):
    done = run(record(tmp_path / "none.pcap", []), "-o", tmp_path / "a.html", "--profile", "dcp-2.0")
    assert "no DCP frames" in done.err
    text = (tmp_path / "a.html").read_text("utf-8")
    assert "There are no frames at all." in Page(text).text
    assert "<svg" not in text


@pytest.mark.parametrize("profile", ["sim-1.0", "student-2024"])
def test_profiles_without_this_and_that(profile, tmp_path):
    codec = get_codec(profile)
    recorded = gather(str(record(tmp_path / "a.pcap", [])), profile, None)
    assert recorded.outcome.profile == codec.profile.name
    assert self_contained(render([chapter(recorded)]))


def test_several_recordings_are_chapters(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    one, two = record(tmp_path / "1.pcap", steady(1, 2)), record(tmp_path / "2.pcap", steady(2, 2))
    assert run(one, two, tmp_path / "none.pcap", "-p", "dcp-2.0").status == 2
    text = (tmp_path / "report.html").read_text("utf-8")
    assert self_contained(text).many("article") == 2


def test_refusals(run, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = record(tmp_path / "a.pcap", steady(1, 1))
    assert run(path, "-p", "dcp-2.0").status == 0
    kept = (tmp_path / "a.html").read_bytes()
    cases: list[tuple[tuple[Any, ...], str]] = [
        ((path, "-p", "dcp-2.0"), "a.html: is there already; --force replaces it"),
        ((path, "-p", "dcp-9.9", "--force"), "dcp-9.9"),
        ((tmp_path / "none.pcap", "-o", "b.html"), "none.pcap"),
        (("*.nonsense", "-o", "b.html"), "nothing matches this pattern"),
        (("-", "-o", "b.html"), "name the --profile"),
        ((path, "-p", "dcp-2.0", "-o", path / "x.html"), "a.pcap"),
        ((path, "-p", "dcp-2.0", "-o", "pipe", "--force"), "pipe: is no regular file, and is not replaced"),
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


def test_memory_has_an_end(tmp_path):
    """Beyond so many rows nothing is kept, and the page says so."""
    path = record(tmp_path / "a.pcap", steady(2, 20))
    whole = gather(str(path), "dcp-2.0", None)
    assert whole.outcome.problems == []
    # Blocks are taken whole: with one block all of it is there, and it is said that there might be more.
    cut = gather(str(path), "dcp-2.0", None, most=1)
    assert cut.outcome.frames == whole.outcome.frames
    (problem,) = cut.outcome.problems
    assert f"only the first {cut.outcome.frames:,} frames are in this report" in problem
    assert problem in Page(render([chapter(cut)])).text


def test_senders_on_several_interfaces(tmp_path):
    """The first beacon of a sender on each interface says nothing of a rate."""
    recorded = gathered(record(tmp_path / "a.pcap", steady(1, 10)))
    table = recorded.tables["beacons"]
    time = analysis.time_of(recorded)
    (alone,) = analysis.senders_of(recorded, time, analysis.steps_of(recorded))
    table["interface"] = np.arange(table["node"].size, dtype=np.uint32) % 2 * (2**32 - 1)
    (both,) = analysis.senders_of(recorded, time, analysis.steps_of(recorded))
    assert alone.rate * (both.beacons - 2) == pytest.approx(both.rate * (alone.beacons - 1))


def test_a_page_has_an_end(run, tmp_path):
    for number in range(21):
        (tmp_path / f"{number}.pcap").write_bytes(b"")
    done = run(tmp_path, "-o", tmp_path / "a.html")
    assert done.status == 2
    assert "a page holds 20 recordings, and these are 21" in done.err


def test_missing_package_is_named(run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "matplotlib", None)
    for module in [each for each in sys.modules if each.startswith("dcp_codec.report.")]:
        monkeypatch.delitem(sys.modules, module)
    done = run(record(tmp_path / "a.pcap", []), "-o", tmp_path / "a.html")
    assert done.status == 2
    assert "matplotlib is not installed: pip install 'dcp-conformance-kit[report]'" in done.err
