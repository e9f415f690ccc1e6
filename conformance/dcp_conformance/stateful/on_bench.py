"""Execute sequences on the bench of a case: over any link, in real or virtual time, beside other cases."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from dcp_conformance.lower_tester import Impairs
from dcp_conformance.oracle.judgement import MS, Timing
from dcp_conformance.test_system.bench import Bench
from dcp_conformance.upper_tester import Answer

from .executor import TWIN, Event, special, twin
from .steps import EPOCH, GROUP

#: Longest duration of a call in ns with which the state is queried after each step.
_QUICK: Final = 20 * MS
_PARAMETERS: Final = (
    "BPPAR_BEACON_PERIOD", "BPPAR_NETWORK_ID", "BPPAR_MAXIMUM_PACKET_SIZE", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT",
    "VARDISPAR_MAX_VALUE_LENGTH", "VARDISPAR_MAX_DESCRIPTION_LENGTH", "VARDISPAR_MAX_REPETITIONS",
    "VARDISPAR_MAX_PAYLOAD_SIZE", "VARDISPAR_MAX_SUMMARIES", "VARDISPAR_SCRUBBING_PERIOD",
)  # fmt: skip
#: Those that decide statuses and contents.
_DECIDING: Final = frozenset(_PARAMETERS) - {"BPPAR_BEACON_PERIOD", "BPPAR_NETWORK_ID"}
#: Creation times from this one on are an hour ahead.
_LATER: Final = 8
_HOUR: Final = 3_600


class BenchNames:
    """Identifiers that no other case uses."""

    def __init__(self, bench: Bench) -> None:
        self._bench = bench
        self._variables: dict[int, int] = {}
        self._neighbours: dict[int, tuple[bytes, bytes]] = {}
        self._protocols: dict[int, int] = {}
        self._base = bench.records.creation_time()
        self._unit = bench.profile.types.timestamp.per_second
        self._late = False
        """True if the sequence has used a creation time one hour in the future."""

    def protocol(self, number: int) -> int:
        """Return the identifier of a protocol that is not registered."""
        if number not in self._protocols:
            session = self._bench.session
            session.next_protocol += 1
            self._protocols[number] = 0x4000 + session.next_protocol % 0x4000
        return self._protocols[number]

    def variable(self, number: int) -> int:
        """Return the identifier of a variable that was never used before."""
        if number not in self._variables:
            self._variables[number] = self._bench.identifiers.own_var_id()
            if self._late:
                self._bench.identifiers.created_by_others(self._variables[number])
        return self._variables[number]

    def neighbour(self, number: int) -> tuple[bytes, bytes]:
        """Return identifier and address of a node that does not exist; 0 and 1 differ in an octet in the middle."""
        if number not in self._neighbours:
            self._neighbours[number] = self._bench.identifiers.new_node()
            node_id, address = self._neighbours[number]
            if number in (1, TWIN) and node_id == address:
                other = self.neighbour(0)[0] if number == 1 else self._bench.identifiers.sut_id
                self._neighbours[number] = twin(other) if len(other) == len(node_id) else (node_id, address)
            elif number == GROUP and node_id == address:
                # Another case may use the identifier 0 at the same time: ZERO is any other neighbour here.
                self._neighbours[number] = special(node_id, number), address
        return self._neighbours[number]

    def creation(self, number: int) -> int:
        """Return a creation time in ticks."""
        if number == EPOCH:
            return 0
        found = self._base + max(1, self._unit // 1000) * number
        if number >= _LATER:
            # Later cases do not have such times, so they must not have these variables either.
            self._late = True
            for each in self._variables.values():
                self._bench.identifiers.created_by_others(each)
            return found + _HOUR * self._unit
        self._bench.session.creation_time = max(self._bench.session.creation_time, found)
        return found


class BenchExecutor:
    """The implementation of a run, for one case."""

    crowds = 16
    lossy_services = True

    def __init__(self, bench: Bench, *, alone: bool) -> None:
        """``alone``: whether no other case is executed beside this one."""
        self._bench = bench
        self.codec = bench.codec
        self.names = BenchNames(bench)
        upper = bench.session.upper
        self.methods: frozenset[str] = frozenset() if upper is None else upper.methods
        self.own_id = bench.identifiers.sut_id
        self.hears_vardis = bench.sut.pics.vardis is not False
        claimed = bench.sut.pics.transmit_payload_confirm
        self.confirms = bench.profile.behaviour.transmit_payload_confirm if claimed is None else claimed
        self.readings: Mapping[str, str] = bench.session.pics.readings
        call = bench.session.slow_call
        self.looks = call <= _QUICK
        self.alone = alone
        period = bench.period
        late = round(bench.sut.reaction * period)
        self.timing = Timing(
            period=period,
            flight=period // 2 + 2 * call,
            late=late,
            notice=late + 2 * call + 200 * MS,
            patience=late + 12 * period + 2 * call,
            lossy=isinstance(bench.lower, Impairs),
        )
        self._beacons = len(bench.heard)
        self._notifications = len(bench.receiver.notifications)

    @staticmethod
    def unknown(bench: Bench, *protocols: str) -> str:
        """Return a parameter of these protocols whose value is only assumed; empty if there is none."""
        names = (each for each in _PARAMETERS if each.startswith(protocols) and each in _DECIDING)
        return next((each for each in names if bench.sut.is_assumed(each)), "")

    def parameters(self) -> dict[str, Any]:
        """Return the values of all parameters; usual ones if they are unknown."""
        found = {name: self._bench.sut.parameter(name) for name in _PARAMETERS}
        if not self._bench.profile.has_header_field("networkId"):
            del found["BPPAR_NETWORK_ID"]
        return found

    def now(self) -> int:
        """Return monotonic ns of the lower tester."""
        return self._bench.now()

    def wall(self) -> int:
        """Return ns since 1970."""
        return self._bench.lower.wall()

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Call a service."""
        return self._bench.call(method, **params)

    def send(self, octets: bytes, source: bytes, blocks: int) -> None:
        """Send a beacon. Wait until it is processed if the implementation processes one beacon at a time."""
        bench = self._bench
        bench.transmission.send(octets, source, blocks)
        if (busy := bench.sut.busy_until - bench.now()) > 0:
            # The time limits of the model hold only while no other beacon waits to be processed.
            bench.waiting.wait_ns(busy)

    def wait(self, duration: int) -> list[Event]:
        """Let time pass, and return what came since the last call."""
        bench = self._bench
        left = duration
        while True:
            # Notifications are read along with frames, and there may be no more frames.
            part = min(left, self.timing.period)
            bench.waiting.wait_ns(part)
            bench.receiver.take_notifications()
            left -= part
            if left <= 0:
                break
        heard, told = bench.heard[self._beacons :], bench.receiver.notifications[self._notifications :]
        self._beacons, self._notifications = len(bench.heard), len(bench.receiver.notifications)
        events = [Event(each.time, each.octets) for each in heard]
        events += [Event(each.time, b"", each.method, each.params) for each in told]
        return sorted(events, key=lambda each: each.time)

    def died(self) -> str:
        """Return nothing: the runner finds out whether the implementation lives."""
        return ""
