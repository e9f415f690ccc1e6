"""The rules by which Hypothesis draws sequences: services, beacons of neighbours, parameters, activity, time.

Sizes and counts are drawn at the boundaries that are in force when the step is taken (of a registration, a parameter,
a width). Preconditions leave out steps that cannot have an effect. Smaller numbers are simpler, so that a sequence
shrinks to few steps with usual values.
"""

from __future__ import annotations

from collections import Counter
from typing import Any, ClassVar, Final

from dcp_spec.constants import QueueingMode, SpecVersion
from hypothesis import strategies as st
from hypothesis import target
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from dcp_conformance.oracle.bp import Client as Registration

from .driver import Counterexample, Driver
from .executor import Executor
from .steps import OWN, Beacon, Call, Client, RecordKind, Records, Report, Step, Wait

PROTOCOLS: Final = st.sampled_from((0, 1, 2))
VARIABLES: Final = st.sampled_from((0, 1, 2, 3, 4))
NEIGHBOURS: Final = st.sampled_from((0, 1, 2))
#: Beacon periods of a wait.
PERIODS: Final = st.sampled_from((1.0, 0.4, 2.5, 5.0, 12.0, 40.0))
_QUEUES: Final = (QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD)
_FAULTS: Final = st.sampled_from(("",) * 9 + ("version", "magic", "network", "own-sender", "no-length", "no-payloads"))
_TIMEOUTS: Final = st.sampled_from((0, 0, 300, 1200, 5000, 65000))
_KINDS: Final[tuple[RecordKind, ...]] = ("create", "update", "delete", "summary", "ask-update", "ask-create")
#: Numbers of variables at once: few, more than fit into a small payload, more than half of a container.
_CROWDS: Final = st.sampled_from((6, 30, 140, 200))


class NodeMachine(RuleBasedStateMachine):
    """Draws a sequence, executes it on an implementation, and judges it with the model.

    Subclasses return the implementation from :meth:`open`; with :meth:`close` they take it back.
    """

    reached: ClassVar[Counter[tuple[str, str]]] = Counter()
    """The pairs (state of the model, event) of all sequences, with the number of their occurrences."""
    executed: ClassVar[Counter[str]] = Counter()
    """Number of sequences and steps."""

    def __init__(self) -> None:
        super().__init__()
        self.executor = self.open()
        self.driver = Driver(self.executor, self.reached)
        self.counterexample: Counterexample | None = None
        self._version = self.executor.codec.profile.spec_version
        self._vardis = any(each.startswith("RTDB-") for each in self.executor.methods)

    def open(self) -> Executor:
        """Return an implementation in its initial state."""
        raise NotImplementedError

    def close(self, executor: Executor) -> None:
        """Release what :meth:`open` returned."""

    def take(self, step: Step) -> None:
        """Execute a step."""
        self.executed["steps"] += 1
        try:
            self.driver.step(step)
        except Counterexample as found:
            self.counterexample = found
            raise

    def teardown(self) -> None:
        """Finish the sequence, unless it has ended with a counterexample."""
        self.executed["sequences"] += 1
        try:
            if self.counterexample is None:
                self.driver.finish()
                target(float(sum(1 / self.reached[pair] for pair in self.driver.pairs)), label="rare pairs")
        finally:
            self.close(self.executor)

    # -- what there is ---------------------------------------------------------------------------------------

    def has(self, method: str) -> bool:
        """Return whether the upper tester has a method."""
        return method in self.executor.methods

    def registrations(self) -> dict[int, Registration]:
        """Return the registrations by the numbers of the sequence."""
        clients = self.driver.model.bp.clients
        return {number: clients[prot] for number, prot in self.driver.protocols.items() if prot in clients}

    @property
    def registered(self) -> bool:
        """Whether there is a registration."""
        return bool(self.driver.model.bp.clients)

    # -- BP --------------------------------------------------------------------------------------------------

    @precondition(lambda self: self.has("BP-RegisterProtocol"))
    @rule(
        number=PROTOCOLS,
        size=st.sampled_from((20, 1, 200, "largest", 0, "above")),
        mode=st.sampled_from((*_QUEUES, QueueingMode.ONCE, QueueingMode.REPEAT)),
        entries=st.sampled_from((1, 2, 3, 0, 255, 256, 300)),
        several=st.booleans(),
        name=st.sampled_from((4, 1, 40, 255)),
    )
    def register(
        self, number: int, size: int | str, mode: QueueingMode, entries: int, several: bool, name: int
    ) -> None:
        """Register a client protocol."""
        largest = self.driver.model.bp.largest
        most = largest if size == "largest" else largest + 1 if size == "above" else size
        if self._version < SpecVersion.V1_1:
            mode = QueueingMode.QUEUE if mode in _QUEUES else mode
        params: dict[str, Any] = {"protId": number, "name": name, "maxPayloadSize": most, "queueingMode": mode.value}
        if self._version >= SpecVersion.V1_1:
            params |= {"maxEntries": entries, "allowMultiplePayloads": several}
        self.take(Call("BP-RegisterProtocol", params))

    @precondition(lambda self: self.has("BP-DeregisterProtocol") and self.registered)
    @rule(number=PROTOCOLS)
    def deregister(self, number: int) -> None:
        """Deregister a client protocol."""
        self.take(Call("BP-DeregisterProtocol", {"protId": number}))

    @precondition(lambda self: self.has("BP-TransmitPayload") and self.registered)
    @rule(
        number=PROTOCOLS,
        size=st.sampled_from(("usual", "most", "above", "empty", "one")),
        times=st.sampled_from((1, 2, 3, "fill")),
    )
    def submit(self, number: int, size: str, times: int | str) -> None:
        """Submit payloads."""
        client = self.registrations().get(number)
        most = client.most if client is not None else 4
        octets = {"usual": min(4, most), "most": most, "above": most + 1, "empty": 0, "one": 1}[size]
        if times == "fill":
            times = client.entries + 1 if client is not None and client.mode in _QUEUES else 2
        self.take(Call("BP-TransmitPayload", {"protId": number, "payload": octets}, int(times)))

    @precondition(lambda self: self.has("BP-ClearBuffer") and self.registered)
    @rule(number=PROTOCOLS)
    def clear(self, number: int) -> None:
        """Clear the buffer of a client protocol."""
        self.take(Call("BP-ClearBuffer", {"protId": number}))

    @precondition(lambda self: self.has("BP-MGMT-Deactivate") and self.executor.alone)
    @rule()
    def switch_bp(self) -> None:
        """Deactivate BP, or activate it again."""
        on = self.driver.model.bp.active
        self.take(Call(f"BP-MGMT-{'Deactivate' if on else 'Activate'}"))

    @precondition(lambda self: self.registered)
    @rule(sender=NEIGHBOURS, number=PROTOCOLS, size=st.sampled_from((4, 1, 20, 0)), fault=_FAULTS)
    def payload(self, sender: int, number: int, size: int, fault: Any) -> None:
        """Send a payload to a client protocol."""
        self.take(Beacon(sender, (Client(number, size),), fault))

    # -- parameters ------------------------------------------------------------------------------------------

    @precondition(lambda self: self.has("BP-SetParameter") and self.executor.alone)
    @rule(value=st.sampled_from(("initial", 120, 200, 300, "least")))
    def resize(self, value: int | str) -> None:
        """Set the maximum packet size."""
        model = self.driver.model
        initial = self.driver.initial["BPPAR_MAXIMUM_PACKET_SIZE"]
        least = self.driver.least_packet
        size = initial if value == "initial" else least if value == "least" else min(int(value), initial)
        if size != model.values["BPPAR_MAXIMUM_PACKET_SIZE"]:
            self._set("BP", "BPPAR_MAXIMUM_PACKET_SIZE", size)

    @precondition(lambda self: self.has("BP-SetParameter") and self.executor.alone)
    @rule(factor=st.sampled_from((1, 2, 4, 0.5)))
    def change_period(self, factor: float) -> None:
        """Set the beacon period."""
        self._set("BP", "BPPAR_BEACON_PERIOD", int(self.driver.initial["BPPAR_BEACON_PERIOD"] * factor) or 1)

    @precondition(lambda self: self.has("BP-SetParameter") and self.executor.alone)
    @precondition(lambda self: "BPPAR_NETWORK_ID" in self.driver.model.values)
    @rule(value=st.sampled_from(("initial", 0, 1, 65535)))
    def change_network(self, value: int | str) -> None:
        """Set the network identifier."""
        self._set("BP", "BPPAR_NETWORK_ID", self.driver.initial["BPPAR_NETWORK_ID"] if value == "initial" else value)

    @precondition(lambda self: self.has("SRP-SetParameter") and self.executor.alone)
    @rule(value=st.sampled_from((3000, 1000, 300, 20000, 70000)))
    def change_neighbour_timeout(self, value: int) -> None:
        """Set the timeout of neighbours."""
        self._set("SRP", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", value)

    @precondition(lambda self: self._vardis and self.has("VD-SetParameter") and self.executor.alone)
    @rule(
        what=st.sampled_from(
            ("SUMMARIES", "REPETITIONS", "VALUE_LENGTH", "DESCRIPTION_LENGTH", "PAYLOAD_SIZE", "SCRUB")
        ),
        value=st.sampled_from((1, 2, 15, "initial", 200, 255, 0)),
    )
    def change_vardis(self, what: str, value: int | str) -> None:
        """Set a parameter of VarDis."""
        model = self.driver.model
        name = "VARDISPAR_SCRUBBING_PERIOD" if what == "SCRUB" else f"VARDISPAR_MAX_{what}"
        if name not in self.driver.initial:
            return
        number = int(self.driver.initial[name] if value == "initial" else value)
        if what == "PAYLOAD_SIZE":
            number = min(max(number, model.least_payload), self.driver.initial[name])
        elif what == "SCRUB":
            number = {1: 100, 2: 300, 15: 1000, 200: 2000, 255: 3000}.get(number, 1000)
        number = model.bounded(name, number)
        self._set("VD", name, number)

    def _set(self, protocol: str, name: str, value: Any) -> None:
        self.take(Call(f"{protocol}-SetParameter", {"name": name, "value": value}))

    # -- SRP -------------------------------------------------------------------------------------------------

    @precondition(lambda self: self.has("SRP-UpdateSafetyData"))
    @rule(times=st.sampled_from((1, 2)), pause=st.booleans())
    def hand_down(self, times: int, pause: bool) -> None:
        """Hand safety data down."""
        for _ in range(times):
            if pause:
                self.take(Wait(0.4))
            self.take(Call("SRP-UpdateSafetyData"))

    @precondition(lambda self: self.has("SRP-NeighbourTable"))
    @rule(
        sender=NEIGHBOURS,
        neighbour=st.sampled_from((0, 1, 2, 3)),
        seqno=st.sampled_from((1, 2, 5, 0, (1 << 32) - 1)),
        count=st.sampled_from((1, 1, 1, 2, 12)),
        fault=_FAULTS,
    )
    def report(self, sender: int, neighbour: int, seqno: int, count: int, fault: Any) -> None:
        """Send state reports."""
        self.take(Beacon(sender, (Report(neighbour, seqno, count),), fault))

    # -- VarDis ----------------------------------------------------------------------------------------------

    @precondition(lambda self: self._vardis)
    @rule(
        number=VARIABLES,
        size=st.sampled_from((2, 1, "most", "above", 0)),
        descr=st.sampled_from((3, 1, "most", "above", 0)),
        repetitions=st.sampled_from((1, "most", "above", 0)),
        timeout=_TIMEOUTS,
    )
    def create(self, number: int, size: int | str, descr: int | str, repetitions: int | str, timeout: int) -> None:
        """Create a variable of the node."""
        params = {
            "varId": number,
            "repCnt": self._limit(repetitions, "REPETITIONS"),
            "descr": self._limit(descr, "DESCRIPTION_LENGTH"),
            "value": self._limit(size, "VALUE_LENGTH"),
        }
        if self._version >= SpecVersion.V2_0:
            params["timeout"] = timeout
        self.take(Call("RTDB-Create", params))

    @precondition(lambda self: self._vardis)
    @rule(number=VARIABLES, size=st.sampled_from((2, 1, "most", "above", 0)), times=st.sampled_from((1, 2)))
    def update(self, number: int, size: int | str, times: int) -> None:
        """Update a variable."""
        self.take(Call("RTDB-Update", {"varId": number, "value": self._limit(size, "VALUE_LENGTH")}, times))

    @precondition(lambda self: self._vardis)
    @rule(number=VARIABLES)
    def delete(self, number: int) -> None:
        """Delete a variable."""
        self.take(Call("RTDB-Delete", {"varId": number}))

    @precondition(lambda self: self.has("VD-MGMT-Deactivate") and self.executor.alone)
    @rule()
    def switch_vardis(self) -> None:
        """Deactivate VarDis, or activate it again."""
        on = self.driver.model.vardis.active
        self.take(Call(f"VD-MGMT-{'Deactivate' if on else 'Activate'}"))

    @precondition(lambda self: self.executor.hears_vardis)
    @rule(
        sender=NEIGHBOURS,
        records=st.lists(
            st.tuples(
                st.sampled_from(_KINDS),
                VARIABLES,
                st.sampled_from((0, 1, 2, -1, 127, 128, 129)),
                st.sampled_from((2, 1, "most", "above", 0)),
                st.sampled_from((1, "most", "above", 0)),
                st.sampled_from((0, 1, 2, 9)),
                st.sampled_from((0, 1, 0, OWN)),
                _TIMEOUTS,
            ),
            min_size=1,
            max_size=3,
        ),
        fault=_FAULTS,
    )
    def records(self, sender: int, records: list[Any], fault: Any) -> None:
        """Send instructions about variables."""
        model = self.driver.model.vardis
        blocks = []
        for kind, number, step, size, repetitions, creation, producer, timeout in records:
            known = model.variables.get(self.executor.names.variable(number))
            seqno = step if known is None or kind == "create" else known.now.seqno + step
            blocks.append(
                Records(
                    kind, number, 1, seqno, self._limit(size, "VALUE_LENGTH"), self._limit(size, "DESCRIPTION_LENGTH", 3),
                    self._limit(repetitions, "REPETITIONS"), producer, creation, timeout,
                )
            )  # fmt: skip
        self.take(Beacon(sender, tuple(blocks), fault))

    @precondition(lambda self: self.executor.hears_vardis and self.executor.crowds > 32)
    @rule(
        kind=st.sampled_from(("create", "summary", "delete", "update", "ask-create")),
        count=_CROWDS,
        repetitions=st.sampled_from((1, "most")),
        seqno=st.sampled_from((0, 1)),
        creation=st.sampled_from((1, 2)),
    )
    def crowd(self, kind: Any, count: int, repetitions: int | str, seqno: int, creation: int) -> None:
        """Send instructions about many variables."""
        count = min(count, self.executor.crowds - 8)
        record = Records(kind, 6, count, seqno, 1, 1, self._limit(repetitions, "REPETITIONS"), 0, creation)
        self.take(Beacon(0, (record,)))

    def _limit(self, size: int | str, name: str, usual: int | None = None) -> int:
        """Return a size, or one at the limit of a parameter."""
        most = int(self.driver.model.values[f"VARDISPAR_MAX_{name}"])
        if size == "most":
            return min(most, 255)
        if size == "above":
            return min(most + 1, 255)
        return min(int(size) if usual is None else usual, max(most, 1))

    # -- time ------------------------------------------------------------------------------------------------

    @rule(periods=PERIODS)
    def wait(self, periods: float) -> None:
        """Let time pass."""
        self.take(Wait(periods))
