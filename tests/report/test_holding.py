"""Held values: differences from the producer, how long they last, and which values never arrive."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_tables.report import analysis
from dcp_tables.report.chapter import chapter
from dcp_tables.report.holding import Holding, Pair, Stale, holding, shares
from dcp_tables.report.recorded import Recorded, gather

from dcp_codec import get_codec
from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.analysis.ledger import Ledger
from dcp_codec.capture import open_capture
from dcp_codec.framing.locate import Framing, locate

from .flights import CAPTURES, Sent, ask, create, delete, gathered, name, record, report, summary, update


def holding_of(path: Path, sent: list[Sent]) -> tuple[Recorded, Holding]:
    recorded = gathered(record(path / "a.pcap", sent))
    return recorded, holding(recorded, analysis.time_of(recorded))


def pair(recorded: Recorded, found: Holding, variable: int, node: int) -> Pair:
    (one,) = [each for each in found.pairs if each.variable == variable and recorded.nodes[each.node] == name(node)]
    return one


def beats(node: int, number: int, start: float, end: float, variable: int = 7) -> list[Sent]:
    """Ten beacons a second with a summary."""
    many = round((end - start) * 10)
    return [
        (start + n / 10 + node / 1000, node, round(start * 10) + n, (summary(variable, number),)) for n in range(many)
    ]


@pytest.fixture
def recreated(tmp_path) -> tuple[Recorded, Holding]:
    """Node 1 creates and updates to 9; at 10 s it creates again and comes to 5. Node 2 follows, node 3 keeps 9."""
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a", at=1),))]
    sent += beats(1, 9, 0.5, 10) + beats(2, 9, 0.6, 10.2) + beats(3, 9, 0.6, 20)
    sent += [(10.0, 1, 500, (create(7, 1, b"a", at=2, seqno=5),)), *beats(1, 5, 10.1, 20), *beats(2, 5, 10.2, 20)]
    return holding_of(tmp_path, sent)


def test_a_stale_value_after_a_recreation(recreated):
    recorded, found = recreated
    follows, stale = pair(recorded, found, 7, 2), pair(recorded, found, 7, 3)
    assert not follows.stale_at_end
    assert follows.differs == [pytest.approx((10.0, 10.202), abs=1e-6)]
    assert stale.stale_at_end
    assert (stale.held, stale.produced) == (9, 5)
    assert stale.differs == [pytest.approx((10.0, 19.903), abs=1e-6)]
    (only,) = found.stale
    assert (only.node, only.held, only.produced, only.missed, only.to_the_end) == (stale.node, 9, 5, 1, True)
    # The frame in which the producer sent it first.
    beacons = recorded.tables["beacons"]
    assert beacons["time"][beacons["frame"] == only.frame] == recorded.tables["beacons"]["time"].min() + 10 * 10**9


def test_the_page_begins_with_the_difference(recreated):
    recorded, _ = recreated
    drawn = chapter(recorded)
    first = drawn.sections[0]
    assert first.title == "Values held by each node"
    assert first.words[0].startswith("≠ At the end 1 of 2 nodes have stale values of 1 of 1 variables (7)")
    at_the_end, late = first.tables[:2]
    marked = [cell.text for row in at_the_end.rows for cell in row if cell.bad]
    assert marked == ["≠ 9"]
    (row,) = late.rows
    assert [cell.text for cell in row][:7] == ["7", "…00:03", "9", "10.000", "to the end", "5", "1"]
    assert row[-1].code
    assert f"decode --frames {recreated[1].stale[0].frame} -w 'varId == 7' --profile dcp-2.0" in row[-1].text


def test_the_tooltip_of_a_difference(recreated):
    recorded, found = recreated
    stale = pair(recorded, found, 7, 3)
    assert stale.at(5.0) == (9, 9)
    assert stale.at(12.0) == (9, 5)
    assert stale.at(0.2) == (None, 0)
    plot = next(each for each in chapter(recorded).plots if each.name.endswith("holding"))
    red = next(each.data_source.data for each in plot.figure.renderers if "it holds" in each.data_source.data)
    longest = max(range(len(red["left"])), key=lambda row: red["right"][row] - red["left"][row])
    assert (red["row"][longest], red["it holds"][longest], red["producer"][longest]) == ("7 at …00:03 ≠", "9", "5")
    assert red["longest lag"][longest] == "9.9 s, 1 value"
    # The first three seconds count as being on the way.
    assert red["left"][longest] == pytest.approx(13_000)


def test_a_value_that_arrives_late(tmp_path):
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),))]
    sent += beats(1, 0, 0.1, 5) + beats(2, 0, 0.1, 9)
    sent += [
        (5.0, 1, 99, (update(7, 1, b"b"),)),
        *beats(1, 1, 5.1, 12),
        (9.0, 2, 500, (update(7, 1, b"b"),)),
        *beats(2, 1, 9.1, 12),
    ]
    _, found = holding_of(tmp_path, sent)
    (late,) = found.stale
    assert (late.held, late.produced, late.missed, late.to_the_end) == (0, 1, 1, False)
    # To the last record with the old number.
    assert late.end - late.start == pytest.approx(3.902)


def test_values_that_were_replaced_before_they_could_be_sent(tmp_path):
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),)), (0.05, 2, 0, (summary(7, 0),))]
    sent += [(0.1 * n, 1, n, (update(7, n, b"b"),)) for n in range(1, 9)] + [(0.85, 2, 1, (summary(7, 8),))]
    recorded, found = holding_of(tmp_path, sent)
    one = pair(recorded, found, 7, 2)
    assert (one.values, one.sent, one.stale_at_end) == (8, 1, False)
    assert found.stale == []


def test_a_node_that_never_announces_a_variable(tmp_path):
    sent = [(0.0, 1, 0, (create(7, 1, b"a"),)), *beats(1, 0, 0.1, 6), *beats(2, 3, 0.1, 6, variable=8)]
    recorded, found = holding_of(tmp_path, sent)
    one = pair(recorded, found, 7, 2)
    assert (one.held, one.known, one.absent, one.stale_at_end) == (None, [], True, False)
    assert found.without_producer == [8]
    assert found.stale == []
    (section, *_) = chapter(recorded).sections
    assert "No record about a variable that its producer has: 7 at …00:02." in section.words


def test_a_deletion_that_is_followed_or_ignored_or_not_announced(tmp_path):
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),)), *beats(1, 0, 0.1, 5), (5.0, 1, 99, (delete(7),))]
    sent += [(5 + n / 10, 1, 100 + n, (summary(9, 0),)) for n in range(1, 100)]
    sent += [*beats(2, 0, 0.1, 5), (5.05, 2, 99, (delete(7),)), *beats(2, 0, 5.1, 12, variable=9)]
    sent += [*beats(3, 0, 0.1, 5), *beats(3, 0, 5, 12, variable=9), *beats(4, 0, 0.1, 12)]
    recorded, found = holding_of(tmp_path, sent)
    follows, silent, ignores = (pair(recorded, found, 7, node) for node in (2, 3, 4))
    assert follows.held == silent.held == DELETED
    assert not follows.stale_at_end
    assert not silent.stale_at_end
    assert ignores.stale_at_end
    assert (ignores.held, ignores.produced) == (0, DELETED)


def test_a_node_that_asks_for_a_deleted_variable_does_not_hold_it(tmp_path):
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),)), *beats(1, 0, 0.1, 3), *beats(2, 0, 0.1, 3.1)]
    sent += [(3.0, 1, 90, (delete(7),)), *beats(1, 0, 3.1, 9, variable=9)]
    sent += [(3.2 + n / 10, 2, 100 + n, (ask(7),)) for n in range(55)]
    recorded, found = holding_of(tmp_path, sent)
    one = pair(recorded, found, 7, 2)
    assert (one.held, one.produced, one.stale_at_end) == (UNKNOWN, DELETED, False)
    assert found.stale == []


def test_silence_does_not_count_as_holding(tmp_path):
    """After ten seconds without a record of the variable its state is unknown."""
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),)), *beats(1, 0, 0.1, 40), *beats(2, 0, 0.1, 5)]
    sent += [(5 + n / 10, 2, 100 + n, (report(2, n),)) for n in range(350)]
    recorded, found = holding_of(tmp_path, sent)
    one = pair(recorded, found, 7, 2)
    assert one.known == [pytest.approx((0.102, 15.002), abs=0.2)]
    assert not one.stale_at_end


def test_a_node_that_asks_for_a_variable_does_not_hold_it():
    recorded = gather(str(CAPTURES / "c_latejoin.mcap"), "cpp-2.0", None)
    held = recorded.tables["held"]
    assert UNKNOWN in held["seqno"]


@pytest.mark.parametrize("path", ["b_crud.mcap", "c_latejoin.mcap", "a_bus3.mcap"])
def test_the_same_as_the_ledger(path):
    """Changes from columns equal those that the ledger follows beacon by beacon."""
    codec = get_codec("cpp-2.0")
    recorded = gather(str(CAPTURES / path), "cpp-2.0", None)
    followed, expected = Ledger(), []
    last: dict[tuple[bytes, int], int] = {}
    with open_capture(CAPTURES / path) as reader:
        for frame in reader:
            framing = locate(frame.data, codec.profile.link)
            if not isinstance(framing, Framing):
                continue
            beacon = codec.decode(frame.data[framing.start : framing.end])
            sender = beacon.bp.sender_id
            for change in followed.feed(frame.number, frame.time_ns, sender, beacon):
                if last.get((sender, change.var_id)) != change.number:
                    expected.append((change.var_id, sender.hex(":"), change.frame, change.number))
                last[sender, change.var_id] = change.number
    held, found = recorded.tables["held"], []
    seen: dict[tuple[int, int], int] = {}
    for variable, node, frame, number in zip(
        *(held[each].tolist() for each in ("variable", "node", "frame", "seqno")), strict=True
    ):
        if seen.get((variable, node)) != number:
            found.append((variable, recorded.nodes[node], frame, number))
        seen[variable, node] = number
    assert sorted(found) == sorted(expected)
    assert found


def test_shares():
    assert shares([(0.0, 1.0), (2.5, 3.0)], analysis.np.linspace(0, 4, 5)).tolist() == [1.0, 0.0, 0.5, 0.0]
    assert shares([], analysis.np.linspace(0, 4, 5)).tolist() == [0.0] * 4


def test_unfinished_and_longest_differences_come_first(tmp_path):
    sent: list[Sent] = [(0.0, 1, 0, (create(7, 1, b"a"),)), (0.01, 1, 1, (create(8, 1, b"a"),))]
    sent += beats(1, 3, 1, 30) + [(n / 10, 1, 1000 + n, (summary(8, 3 if n < 100 else 4),)) for n in range(10, 300)]
    sent += beats(2, 0, 1, 20) + beats(2, 3, 20, 30) + [(n / 10, 2, 1000 + n, (summary(8, 3),)) for n in range(10, 300)]
    _, found = holding_of(tmp_path, sent)
    assert [(each.variable, each.to_the_end) for each in found.stale] == [(8, True), (7, False)]
    assert isinstance(found.stale[0], Stale)
