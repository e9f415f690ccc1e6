"""The clock of the world in virtual time and its events."""

from __future__ import annotations

from dcp_codec.common.events import EventQueue
from dcp_stack.virtual.medium import Arrival, SimulatedMedium
from dcp_stack.virtual.quality import Quality
from dcp_stack.virtual.world import EPOCH, LATER, World


def test_events_come_by_time_then_by_rank_then_in_the_order_of_addition() -> None:
    queue: EventQueue[str] = EventQueue()
    for time, name, rank in ((2, "last", 0), (1, "c", 1), (1, "a", 0), (1, "d", 1), (1, "b", 0)):
        queue.push(time, name, rank)
    assert (queue.next_time(), len(queue)) == (1, 5)
    assert list(queue.due(1)) == ["a", "b", "c", "d"]
    assert (queue.pop(), queue.next_time()) == ("last", None)


def test_an_event_that_is_added_during_the_iteration_is_due_as_well() -> None:
    queue: EventQueue[int] = EventQueue()
    queue.push(0, 0)
    found = []
    for number in queue.due(3):
        found.append(number)
        queue.push(number + 1, number + 1)
    assert found == [0, 1, 2, 3]


def test_frames_come_before_actions_of_the_same_time() -> None:
    seen: list[object] = []
    medium = SimulatedMedium(2, Quality(delay=5))
    world = World(medium, lambda arrival: seen.append(arrival.octets))
    world.at(5, lambda: seen.append("second"), LATER + 1)
    world.at(5, lambda: seen.append("first"))
    medium.broadcast(0, b"frame", 0)
    assert [type(each) for each in medium.queue if isinstance(each, Arrival)] == [Arrival]
    assert not world.run_until(4)
    assert (world.now, world.wall, seen) == (4, EPOCH + 4, [])
    assert world.run_until(9, stop=lambda: len(seen) == 2)
    assert (world.now, seen) == (5, [b"frame", "first"])
    world.at(0, lambda: seen.append("now, not in the past"))
    world.run_until(9)
    assert (world.now, seen[2:]) == (9, ["now, not in the past", "second"])
