"""A lower tester on a bad link, in virtual time: when frames leave and arrive, and what the tester knows."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from dcp_conformance.errors import UsageError
from dcp_conformance.impaired_link import Directions, ImpairedLowerTester, impaired, incidents_text, parse_directions
from dcp_conformance.lower_tester import Arrival, Incident, LinkHealth

from dcp_codec.impairment import Impairment, parse_impairment

MS = 1_000_000


class Air:
    """A lower tester in virtual time that notes what is sent and hears what a test has planned."""

    name = "air"

    def __init__(self) -> None:
        self.time = 1000 * MS
        self.sent: list[tuple[int, bytes]] = []
        self.planned: list[Arrival] = []

    def plan(self, after_ms: int, octets: bytes) -> None:
        time = 1000 * MS + after_ms * MS
        self.planned.append(Arrival(time, time, octets, b"\xff" * 14 + octets, b"node"))

    def now(self) -> int:
        return self.time

    def wall(self) -> int:
        return self.time

    def framed(self, octets: bytes, source: bytes) -> bytes:
        return b"frame of " + source + octets

    def send(self, octets: bytes, source: bytes) -> bytes:
        self.sent.append(((self.time - 1000 * MS) // MS, octets))
        return self.framed(octets, source)

    def send_frame(self, frame: bytes) -> None:
        self.send(frame, b"")

    def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
        if self.planned and self.planned[0].time < until:
            self.time = max(self.time, self.planned[0].time)
            return self.planned.pop(0)
        self.time = max(self.time, until)
        return None

    def take_in(self) -> None:
        pass

    def health(self) -> LinkHealth:
        return LinkHealth(2)

    def close(self) -> None:
        pass


def link(air: Air, to: str = "", back: str = "", tolerance: int = 0) -> ImpairedLowerTester:
    return ImpairedLowerTester(air, Directions(parse_impairment(to), parse_impairment(back)), tolerance=tolerance)


def heard(lower: ImpairedLowerTester, until_ms: int) -> list[tuple[int, bytes]]:
    found = []
    while (arrival := lower.receive(1000 * MS + until_ms * MS)) is not None:
        assert arrival.time - arrival.wall == 0
        found.append(((arrival.time - 1000 * MS) // MS, arrival.octets))
    assert lower.now() == 1000 * MS + until_ms * MS
    return found


def test_frames_are_delayed_in_both_directions() -> None:
    air = Air()
    lower = link(air, "delay=5ms", "delay=7ms")
    for after in (1, 2, 30):
        air.plan(after, b"%d" % after)
    assert lower.send(b"one", b"a") == b"frame of aone"
    assert heard(lower, 3) == []
    lower.send_frame(b"two")
    assert heard(lower, 9) == [(8, b"1")]
    assert heard(lower, 50) == [(9, b"2"), (37, b"30")]
    assert air.sent == [(5, b"one"), (8, b"two")]


def test_a_frame_at_the_end_of_a_wait_belongs_to_the_next_wait() -> None:
    air = Air()
    lower = link(air, "", "delay=7ms")
    air.plan(3, b"x")
    assert heard(lower, 10) == []
    assert heard(lower, 11) == [(10, b"x")]


def test_a_readable_descriptor_ends_the_wait() -> None:
    class Told(Air):
        def receive(self, until: int, also: Sequence[int] = ()) -> Arrival | None:
            return None

    assert link(Told(), "delay=5ms", "delay=5ms").receive(2000 * MS, [1]) is None


def test_the_link_only_delays_while_no_case_is_executed() -> None:
    air = Air()
    lower = link(air, "loss=1,delay=2ms", "loss=1,delay=2ms")
    air.plan(1, b"calm")
    lower.send(b"calm", b"a")
    assert heard(lower, 10) == [(3, b"calm")]
    with lower.engaged():
        air.plan(11, b"lost")
        lower.send(b"lost", b"a")
        assert heard(lower, 20) == []
    air.plan(21, b"calm again")
    lower.send(b"calm again", b"a")
    assert heard(lower, 30) == [(23, b"calm again")]
    assert [octets for _, octets in air.sent] == [b"calm", b"calm again"]
    assert lower.health() == LinkHealth(2, (Incident(True, "lost", b"lost"), Incident(False, "lost", b"lost")))
    assert lower.health() == LinkHealth(2)
    assert [(each.offered, each.lost) for each in lower.counters] == [(1, 1), (1, 1)]
    assert "to the implementation 1 of 1 frames lost; from it 1 of 1 frames lost." in lower.summary()


def test_frames_changed_by_the_link_are_not_attributed_to_the_implementation() -> None:
    air = Air()
    lower = link(air, back="duplicate=1")
    with lower.engaged():
        air.plan(1, b"once")
        assert heard(lower, 5) == [(1, b"once")]
    assert lower.health().incidents == ()
    lower = link(air, back="corrupt_frames=1")
    with lower.engaged():
        air.plan(6, b"corrupted")
        assert heard(lower, 10) == []
    assert lower.health().incidents == (Incident(False, "corrupted", b"corrupted"),)


def test_stimuli_are_corrupted_and_repeated_and_the_tester_knows() -> None:
    air = Air()
    lower = link(air, "corrupt_frames=1,duplicate=1")
    with lower.engaged():
        assert lower.send(b"abc", b"a") == b"frame of aabc", "the frame before impairment"
        lower.send_frame(b"\xff" * 14 + b"abc")
    (_, first), (_, again), (_, frame), _ = air.sent
    assert first == again != b"abc"
    assert frame[:14] == b"\xff" * 14
    assert frame[14:] != b"abc"
    assert [each.what for each in lower.health().incidents] == ["corrupted", "duplicated"] * 2


def test_a_beacon_that_is_held_back_is_marked_when_it_arrives() -> None:
    air = Air()
    lower = link(air, back="reorder=1,reorder_delay=20ms")
    air.plan(1, b"x")
    with lower.engaged():
        assert heard(lower, 10) == []
        assert lower.health().incidents == ()
        arrival = lower.receive(2000 * MS)
    assert arrival is not None
    assert arrival.disturbed
    assert lower.health().incidents == (Incident(False, "reordered", b"x"),)


@pytest.mark.parametrize(("tolerance", "late"), [(0, True), (10 * MS, False)])
def test_jitter_within_the_tolerance_is_not_an_incident(tolerance: int, late: bool) -> None:
    air = Air()
    lower = link(air, "delay=5ms,jitter=9ms", "delay=5ms,jitter=9ms", tolerance)
    assert lower.changes_intervals
    air.plan(1, b"x")
    lower.send(b"y", b"a")
    arrival = lower.receive(2000 * MS)
    assert arrival is not None
    assert arrival.disturbed is late
    assert [(each.to, each.what) for each in lower.health().incidents] == [(True, "late"), (False, "late")] * late


def test_a_call_can_wait_until_all_frames_have_arrived() -> None:
    air = Air()
    lower = link(air, "delay=5ms")
    air.plan(3, b"meanwhile")
    lower.send(b"x", b"a")
    lower.settle()
    assert air.sent == [(5, b"x")]
    assert lower.receive(lower.now() + MS) is not None, "frames that arrive during sending are kept"


def test_a_late_frame_of_an_earlier_case_is_reported_in_the_current_case() -> None:
    air = Air()
    lower = link(air, "reorder=1,reorder_delay=20ms")
    with lower.engaged():
        lower.send(b"x", b"a")
        assert [each.what for each in lower.health().incidents] == ["reordered"]
    with lower.engaged():
        heard(lower, 30)
        assert [each.what for each in lower.health().incidents] == ["reordered"]
    assert air.sent == [(20, b"x")]


def test_a_perfect_link_changes_nothing() -> None:
    air = Air()
    assert impaired(air, parse_directions(["loss=0"]), seed=1, tolerance=0) is air
    assert isinstance(impaired(air, parse_directions(["loss=0.1"]), seed=1, tolerance=0), ImpairedLowerTester)


# -- the option --------------------------------------------------------------------------------------------------------


def test_directions_are_given_together_or_one_by_one() -> None:
    one, other = Impairment(loss=0.1), Impairment(delay=5 * MS)
    assert parse_directions(["loss=0.1"]) == (one, one)
    assert parse_directions(["to:loss=0.1"]) == (one, Impairment())
    assert parse_directions(["from:delay=5ms", "to:loss=0.1"]) == (one, other)
    assert parse_directions([]) == (Impairment(), Impairment())
    assert str(parse_directions(["loss=0.1"])) == "loss=0.1"
    assert str(parse_directions(["from:delay=5ms", "to:loss=0.1"])) == "to:loss=0.1; from:delay=5ms"


@pytest.mark.parametrize(
    ("texts", "said"),
    [
        (["los=1"], "--impair los=1: los: unknown key"),
        (["to:loss=2"], "--impair to:loss=2: loss: 2 is not within 0..1"),
        (["loss=0.1", "to:delay=5ms"], "--impair to:delay=5ms: the direction 'to' was given before"),
        (["there:loss=1"], "--impair there:loss=1: there:loss: unknown key"),
    ],
)
def test_invalid_options_are_refused(texts: list[str], said: str) -> None:
    with pytest.raises(UsageError) as caught:
        parse_directions(texts)
    assert str(caught.value).startswith(said)


def test_incidents_in_words() -> None:
    found = [Incident(True, "lost", b""), Incident(False, "lost", b""), Incident(True, "corrupted", b"")]
    assert incidents_text(found, [12, 0, 13]) == (
        "lost on the impaired link: frame 12 to the implementation, 1 beacon of the implementation; "
        "corrupted on the impaired link: frame 13 to the implementation"
    )
    many = [Incident(True, "lost", b"")] * 5
    assert incidents_text(many, [1, 2, 3, 4, 5]) == (
        "lost on the impaired link: frames 1, 2, 3 and 2 more to the implementation"
    )
    assert (
        incidents_text([Incident(True, "reordered", b"")], [0])
        == "held back on the impaired link: 1 frame of an earlier case"
    )
