"""The steps and checks of network tests: services at places, time, links, and the values held by stations."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any, Final

from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict
from dcp_conformance.upper_tester import Answer
from dcp_spec.constants import features

from dcp_codec.analysis.entry import DELETED, UNKNOWN
from dcp_codec.analysis.ledger import Ledger
from dcp_codec.errors import DecodeError
from dcp_codec.impairment import Impairment, Outage
from dcp_lab.testing.mutation import Mutator

from .bounds import cycle_time, expected_time, spreading_time, time_through_outages
from .definition import Shape
from .results import Spread, TimelineEntry
from .world import Limits, Sent, World

MS: Final = 1_000_000
SECOND: Final = 1_000_000_000
#: Time between two checks of received frames, and between two state reports of a node (ns).
_LOOK: Final = 20 * MS
_REPORT: Final = 100 * MS
#: Moments of a cell that the timeline keeps.
_MOST_MOMENTS: Final = 2000


class NotApplicableError(Exception):
    """The test cannot run with these implementations; the message is the reason."""


class StopError(Exception):
    """The test cannot continue after a failed check."""


class Scene:
    """One network test in one world."""

    def __init__(self, world: World, shape: Shape, requirements: tuple[str, ...], seed: int) -> None:
        self.world = world
        self.shape = shape
        self.places = list(range(len(shape.roles)))
        self.rng = random.Random(f"scene/{seed}")  # noqa: S311 - to be repeatable is the point
        self.checks: list[Check] = []
        self.moments: list[TimelineEntry] = []
        self.spreads: list[Spread] = []
        self.left_out = 0
        self.restarts: list[tuple[int, int]] = []
        """Times (ns) and places that were switched on again."""
        self.strangers: set[bytes] = set()
        """Node identifiers that the tester itself uses: nothing that they do is a finding."""
        self.loss = 0.0
        """The expected loss of the links, for the time that spreading may take."""
        self.outages = False
        """Whether links are down most of the time, as :func:`bounds.cycle_time` has it."""
        self.held: dict[int, Ledger] = {place: Ledger() for place in self.places}
        """The records that each place has sent about variables since it was switched on."""
        self.heard_from: dict[int, int] = {}
        """By place: the time of its last transmission."""
        self._requirements = requirements
        self._seen = 0
        self._reporting: set[int] = set()
        self._next_report = 0
        self._values: dict[int, bytes] = {}
        self._numbers: dict[int, int] = {}
        """By variable: the sequence number that follows from the services called."""

    # -- facts ---------------------------------------------------------------------------------------------------------

    def role(self, role: str) -> list[int]:
        """The places of an implementation, ``A`` or ``B``."""
        return [place for place in self.places if self.shape.roles[place] == role]

    @property
    def limits(self) -> Limits:
        """The strictest limits of all places."""
        each = [place.limits for place in self.world.places]
        names = (name for name in Limits.__struct_fields__ if name != "network_id")
        strictest = {name: max if name.endswith("_ms") else min for name in names}
        return Limits(**{name: which(getattr(x, name) for x in each) for name, which in strictest.items()})

    def require(self, condition: bool, reason: str) -> None:
        """End the test as not applicable unless ``condition`` holds."""
        if not condition:
            raise NotApplicableError(reason)

    def require_summaries(self) -> None:
        """End the test as not applicable if a station sends no summaries: nothing lost is then ever asked for."""
        self.require(self.limits.summaries > 0, "a station sends no summaries (VARDISPAR_MAX_SUMMARIES is 0)")

    # -- stations and services -----------------------------------------------------------------------------------------

    def start(self, places: Iterable[int] | None = None) -> None:
        """Switch places on (all, unless given), and wait until each has had the time to send a beacon."""
        chosen = self.places if places is None else list(places)
        for place in chosen:
            self.switch(place, on=True)
        self.wait(3 * self.limits.beacon_period_ms / 1000)

    def switch(self, place: int, *, on: bool) -> None:
        """Switch a station on or off; it loses all state."""
        self._look()
        self.note(place, "switched on" if on else "switched off")
        if on and any(frame.place == place for frame in self.world.sent()):
            self.restarts.append((self.world.now, place))
        self.world.power(place, on=on)
        self.held[place] = Ledger()
        self.heard_from.pop(place, None)

    def call(self, place: int, method: str, **params: Any) -> Answer:
        """Call a service. Ends the test as not applicable if the station does not offer it."""
        answer = self.world.call(place, method, params)
        if answer is None:
            raise NotApplicableError(f"{method} cannot be called at place {place} ({self.name(place)})")
        self._look()
        return answer

    def can(self, place: int, method: str) -> bool:
        """Whether a method can be called at a place."""
        return bool(self.world.offers(place, method))

    def name(self, place: int) -> str:
        """The implementation at a place."""
        return self.world.places[place].implementation

    def create(self, place: int, variable: int, value: bytes, *, repetitions: int = 1, timeout: int = 0) -> None:
        """Create a variable; a refusal fails the test. ``timeout`` is in ms (2.0)."""
        params: dict[str, Any] = {"varId": variable, "repCnt": repetitions, "descr": "v", "value": value.hex()}
        if features(self.world.places[place].codec.profile.spec_version).creation_time:
            params["timeout"] = timeout
        self._serve(place, "RTDB-Create", variable, params)
        self._values[variable], self._numbers[variable] = value, 0

    def update(self, place: int, variable: int, value: bytes) -> None:
        """Update a variable of this station; a refusal fails the test."""
        self._serve(place, "RTDB-Update", variable, {"varId": variable, "value": value.hex()})
        modulus = 1 << (8 * self.world.places[place].codec.profile.types.var_seqno.width)
        self._values[variable], self._numbers[variable] = value, (self._numbers[variable] + 1) % modulus

    def delete(self, place: int, variable: int) -> None:
        """Delete a variable of this station; a refusal fails the test."""
        self._serve(place, "RTDB-Delete", variable, {"varId": variable})
        self._values.pop(variable, None)
        self._numbers.pop(variable, None)

    def _serve(self, place: int, method: str, variable: int, params: dict[str, Any]) -> None:
        answer = self.call(place, method, **params)
        value = f" = {params['value']}" if "value" in params else ""
        self.note(place, f"{method} {variable}{value}: {answer}")
        if not answer.ok:
            self.expect(
                False, f"{method} of variable {variable} at place {place} ({self.name(place)}) is confirmed with OK",
                f"the confirm is {answer}",
            )  # fmt: skip
            raise StopError

    def report_states(self) -> None:
        """Submit safety data at all places every 100 ms from now on."""
        least = min(place.limits.neighbour_timeout_ms for place in self.world.places)
        self.require(
            2 * self.limits.beacon_period_ms < least,
            "the neighbour table timeout of a station is below two beacon periods: entries come and go",
        )
        for place in self.places:
            if self.world.offers(place, "SRP-UpdateSafetyData") is False:
                raise NotApplicableError(f"SRP-UpdateSafetyData cannot be called at place {place} ({self.name(place)})")
        self._reporting = set(self.places)
        self._next_report = self.world.now

    def neighbours_of(self, place: int) -> list[int] | None:
        """The places in the neighbour table of a place, ascending; None if it cannot be read."""
        answer = self.world.call(place, "SRP-NeighbourTable", {})
        if answer is None or not answer.ok:
            return None
        numbers = {each.node_id: each.number for each in self.world.places}
        found = []
        for entry in answer.result.get("neighbours", ()):
            octets = bytes.fromhex(str(entry["nodeId"]).replace(":", ""))
            found.append(numbers.get(octets, numbers.get(octets.hex(":").encode(), -1)))
        return sorted(found)

    # -- links ---------------------------------------------------------------------------------------------------------

    def set_quality(self, impairment: Impairment, sender: int | None = None, receiver: int | None = None) -> None:
        """Change the links, or those from and to single places."""
        self.loss = max(self.loss if sender is not None else 0.0, impairment.mean_loss)
        self.note(None, f"links: {impairment or 'perfect'}")
        self.world.set_quality(impairment, sender, receiver)

    def set_outages(self) -> None:
        """Let all links be down two thirds of the time, in turns that leave room for one attempt to cross a hop."""
        up, down = (round(each * SECOND) for each in cycle_time(self.limits))
        self.set_quality(Impairment(down=(Outage(up // 2, down, up + down),)))
        self.outages = True

    def partition(self, *groups: Sequence[int]) -> None:
        """Let frames stay within their groups; no groups: heal."""
        self.note(None, f"partition {' | '.join(str(list(g)) for g in groups)}" if groups else "the partition ends")
        self.world.partition(groups)

    # -- time ----------------------------------------------------------------------------------------------------------

    def wait(self, seconds: float) -> None:
        """Let time pass."""
        self._pass_until(self.world.now + round(seconds * SECOND), lambda: False)

    def until(self, reached: Callable[[], bool], limit: float) -> float | None:
        """Wait until ``reached``, at most ``limit`` s; returns the seconds that it took, None if it did not happen."""
        begin = self.world.now
        if self._pass_until(begin + round(limit * SECOND), reached):
            return (self.world.now - begin) / SECOND
        return None

    def _pass_until(self, end: int, reached: Callable[[], bool]) -> bool:
        while True:
            self._report()
            self._look()
            if self.world.deaths():
                # That decides the cell: nothing else is worth waiting for.
                raise StopError
            if reached():
                return True
            left = end - self.world.now
            if left <= 0:
                return False
            self.world.run(min(left, _LOOK))

    def _report(self) -> None:
        if not self._reporting or self.world.now < self._next_report:
            return
        self._next_report = self.world.now + _REPORT
        for place in self._reporting:
            if self.world.is_on(place) and place not in self.world.deaths():
                layout = self.world.places[place].codec.profile.srp.safety_data
                data = {each.name: place + 1 for each in layout if hasattr(each, "type")}
                self.world.call(place, "SRP-UpdateSafetyData", {"sData": data})

    def _look(self) -> None:
        """Take in what was transmitted since the last look."""
        sent = self.world.sent()
        while self._seen < len(sent):
            self._take(sent[self._seen])
            self._seen += 1

    def _take(self, frame: Sent) -> None:
        if frame.place >= len(self.places):
            return
        place = self.world.places[frame.place]
        self.heard_from[frame.place] = frame.time
        try:
            beacon = place.codec.decode(frame.octets)
        except DecodeError:
            return
        for entry in self.held[frame.place].feed(self._seen + 1, frame.time, place.node_id, beacon):
            text = {DELETED: "deletes", UNKNOWN: "asks for"}.get(entry.number, f"has number {entry.number} of")
            self.note(frame.place, f"{text} variable {entry.var_id}", frame=self._seen + 1)

    def damaged(self, pool: Sequence[bytes]) -> Iterator[bytes]:
        """Yield damaged copies of beacons without end: those that no strict decoder of the places' versions takes."""
        codecs = {place.codec.profile.name: place.codec for place in self.world.places}
        mutators = [Mutator(codec, self.rng, pool) for codec in codecs.values()]
        while True:
            for codec, mutator in zip(codecs.values(), mutators, strict=True):
                octets = mutator.mutate().octets[:1400]
                try:
                    codec.decode(octets)
                except DecodeError:
                    if octets:
                        yield octets

    # -- checks --------------------------------------------------------------------------------------------------------

    def note(self, place: int | None, text: str, *, frame: int = 0) -> None:
        """Add a line to the timeline."""
        if len(self.moments) >= _MOST_MOMENTS:
            self.left_out += 1
            return
        self.moments.append(TimelineEntry(round(self.world.now / SECOND, 4), place, text, frame))

    def expect(self, met: bool, expected: str, observed: str = "", *requirements: str) -> bool:
        """Record a check."""
        verdict = Verdict.PASS if met else Verdict.FAIL
        seconds = round(self.world.now / SECOND, 4)
        ids = requirements or self._requirements
        self.checks.append(Check(verdict, ids, expected, "" if met else observed, seconds=seconds))
        if not met:
            self.note(None, f"not met: {expected}; {observed}")
        return met

    def number(self, place: int, variable: int) -> int | None:
        """The sequence number that a place sent last for a variable; None if it never sent one."""
        held = self.held[place].held(self.world.places[place].node_id, variable)
        return None if held is None else held.number

    def lacking(self, variables: Iterable[int], places: Iterable[int]) -> list[str]:
        """Return the places whose records do not show the result of the services called at the producer."""
        found = []
        for variable in variables:
            wanted = self._numbers.get(variable)
            for place in places:
                has = self.number(place, variable)
                if has != wanted:
                    state = {None: "nothing", UNKNOWN: "a request for it", DELETED: "a deletion"}.get(has, f"{has}")
                    found.append(
                        f"place {place} ({self.name(place)}) sent {state} for variable {variable} instead of {wanted}"
                    )
        return found

    def spread_new(self, producer: int, variable: int, value: bytes, **how: Any) -> None:
        """Create a variable, and check that it spreads; ``how``: as for :meth:`expect_spread`."""
        self.create(producer, variable, value)
        self.expect_spread(producer, variable, **how)

    def spread_update(self, producer: int, variable: int, value: bytes, **how: Any) -> None:
        """Update a variable, and check that the update spreads; ``how``: as for :meth:`expect_spread`."""
        self.update(producer, variable, value)
        self.expect_spread(producer, variable, **how)

    def expect_spread(
        self,
        producer: int,
        *variables: int,
        places: Iterable[int] | None = None,
        among: int | None = None,
        what: str = "",
        patience: float = 0.0,
    ) -> None:
        """Check that all places (or ``places``) get the variables of ``producer``, by beacons and services.

        ``among``: the number of variables in the network, which share the summaries of a beacon. ``patience``: seconds
        that are granted in addition, for what the stations still have to work off (a minute at most in real time).
        Raises ``StopError`` if it takes longer: the cell is decided, and each later change could take as long.
        """
        chosen = list(self.places if places is None else places)
        limit = self.time_to_spread(producer, chosen, among or len(variables)) + min(patience, self.world.most_backlog)
        begin = self.world.now
        pending = set(variables)

        def reached() -> bool:
            pending.difference_update([each for each in pending if not self.lacking([each], chosen)])
            return not pending and self.read_differences(variables, chosen, first=True) == []

        took = self.until(reached, limit)
        what = what or f"variable {', '.join(map(str, variables[:3]))}{'...' if len(variables) > 3 else ''}"
        self.spreads.append(Spread(what, round(begin / SECOND, 4), took, round(limit, 3)))
        expected = f"all of places {chosen} hold {what} of place {producer} within {limit:.1f} s"
        if took is None:
            missing = self.lacking(variables, chosen) + self.read_differences(variables, chosen)
            self.expect(False, expected, "; ".join(missing[:4]) + (" ..." if len(missing) > 4 else ""))
            raise StopError
        self.expect(True, expected)

    def read_differences(self, variables: Iterable[int], places: Iterable[int], *, first: bool = False) -> list[str]:
        """Describe which services return another value than the test wrote; ``first`` stops at one."""
        found = []
        for variable in variables:
            wanted = self._values.get(variable)
            for place in places:
                if wanted is None or not self.can(place, "RTDB-Read"):
                    continue
                answer = self.world.call(place, "RTDB-Read", {"varId": variable})
                if answer is None:
                    continue
                value = str(answer.result.get("value", ""))
                if not answer.ok or value.lower() != wanted.hex():
                    found.append(f"RTDB-Read of {variable} at place {place} ({self.name(place)}): {answer} {value}")
                    if first:
                        return found
        return found

    def time_to_spread(self, producer: int, places: Sequence[int], variables: int = 1) -> float:
        """The seconds after which all places must hold what a producer has changed, on this world's machine."""
        distances = self.shape.hops(producer)
        hops = max(distances.get(place, 1) for place in places)
        if self.outages:
            return self._extended(*time_through_outages(hops, self.limits))
        model = (hops, self.loss, variables, self.limits)
        return self._extended(spreading_time(*model), expected_time(*model))

    def _extended(self, limit: float, expected: float) -> float:
        """A limit (s) with the patience that the world's machine needs, from the time that is expected (s)."""
        return limit + (self.world.patience - 1) * min(limit, expected)

    def expect_deleted(self, variable: int, places: Iterable[int] | None = None) -> None:
        """Check that all places (or ``places``) say or show that a variable is deleted; else raise ``StopError``."""
        chosen = list(self.places if places is None else places)
        limit = self.time_to_spread(chosen[0], self.places)

        def alive() -> list[str]:
            return [f"place {place} ({self.name(place)})" for place in chosen if self.is_alive(place, variable)]

        took = self.until(lambda: not alive(), limit)
        self.spreads.append(Spread(f"deletion of {variable}", round(self.world.now / SECOND, 4), took, round(limit, 3)))
        expected = f"variable {variable} is deleted at places {chosen} within {limit:.1f} s"
        if not self.expect(took is not None, expected, f"it is alive at {', '.join(alive())}"):
            raise StopError

    def is_alive(self, place: int, variable: int) -> bool:
        """Whether a place has a variable that is not deleted: by its services, else by the last record that it sent."""
        if self.can(place, "RTDB-Read"):
            answer = self.world.call(place, "RTDB-Read", {"varId": variable})
            if answer is not None:
                return answer.ok
        number = self.number(place, variable)
        return number is not None and number >= 0

    def expect_neighbours(self, limit: float, absent: Iterable[int] = ()) -> None:
        """Check that each place lists exactly its neighbours, without ``absent``, within ``limit`` s (more if busy).

        Raises ``StopError`` if it takes longer, and ``NotApplicableError`` if no place shows its table.
        """
        gone = set(absent)
        limit = self._extended(limit, limit)
        wanted = {p: sorted(set(self.shape.neighbours(p)) - gone) for p in self.places if p not in gone}
        asked = [place for place in wanted if self.can(place, "SRP-NeighbourTable")]
        self.require(bool(asked), "SRP-NeighbourTable cannot be called anywhere")

        def wrong() -> list[str]:
            tables = {place: self.neighbours_of(place) for place in asked}
            return [
                f"place {place} ({self.name(place)}) lists {tables[place]}, not {wanted[place]}"
                for place in asked
                if tables[place] != wanted[place]
            ]

        took = self.until(lambda: not wrong(), limit)
        self.spreads.append(Spread("neighbour tables", round(self.world.now / SECOND, 4), took, round(limit, 3)))
        expected = f"each neighbour table lists exactly the neighbours within {limit:.1f} s"
        if not self.expect(took is not None, expected, "; ".join(wrong())):
            raise StopError

    def expect_talking(self) -> None:
        """Check that every place that is on still sends: with variables it has summaries to say."""
        if not self.limits.summaries:
            return
        quiet = 20 * self.limits.beacon_period_ms * MS

        def silent() -> list[str]:
            return [
                f"place {place} ({self.name(place)})"
                for place in self.places
                if self.world.is_on(place) and self.world.now - self.heard_from.get(place, 0) > quiet
            ]

        # In real time the tester does not listen while it calls services, and hundreds of calls take longer.
        self.until(lambda: not silent(), self._extended(quiet / SECOND, quiet / SECOND))
        found = silent()
        self.expect(not found, "every station that is on sends beacons", f"silent: {', '.join(found)}")
