"""The rules by which Hypothesis draws sequences: services, beacons of neighbours, parameters, activity, time.

Sizes and counts are drawn at the boundaries that are in force when the step is taken (of a registration, a parameter,
a width). Preconditions leave out steps that cannot have an effect. Smaller numbers are simpler, so that a sequence
shrinks to few steps with usual values.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, ClassVar, Final, NamedTuple, cast, get_args

from dcp_spec.constants import QueueingMode, SpecVersion
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, rule

from dcp_conformance.errors import NeverAnsweredError, NoAnswerError
from dcp_conformance.oracle.bp import Client as Registration
from dcp_conformance.oracle.knowledge import NO_CREATION
from dcp_conformance.oracle.knowledge import Variable as Knowledge

from .driver import Counterexample, Driver
from .executor import TWIN, Executor
from .steps import (
    AGAIN,
    DATA,
    ENDS,
    EPOCH,
    FAULTS,
    FILL,
    GROUP,
    OWN,
    ZERO,
    Beacon,
    Call,
    Client,
    Content,
    Damaged,
    Data,
    Fault,
    RecordKind,
    Records,
    Report,
    Step,
    Trait,
    Wait,
)

#: Numbers of protocols, variables and neighbours: mostly the first, since what happens twice to one finds more.
_CLIENTS: Final = 3
#: One of those that there are.
WHICH: Final = st.sampled_from((0, 0, 0, 1, 2))
#: The same, or one that there is not.
_ABSENT: Final = -1
ANY: Final = st.sampled_from((0, 0, 0, 0, 1, 2, _ABSENT))
PROTOCOLS: Final = st.sampled_from((0, 0, 0, 0, 0, 1, 2))
VARIABLES: Final = st.sampled_from((0, 0, 0, 1, 1, 2, 3, 4))
NEIGHBOURS: Final = st.sampled_from((0, 0, 0, 0, 0, 0, 1, 1, 2, 2, TWIN, TWIN, GROUP, ZERO))
#: Beacon periods of a wait.
PERIODS: Final = st.sampled_from((1.0, 0.4, 1.0, 2.5, 1.0, 2.5, 5.0, 8.0, 12.0, 5.0, 0.4, 1.0, 25.0, 40.0, 130.0))
#: The actions of each theme, more frequent ones several times. Sequences with all actions rarely combine related ones.
THEMES: Final[dict[str, tuple[str, ...]]] = {theme: tuple(actions.split()) for theme, actions in {
    "registrations": "renew submit register submit clear switch_bp wait deregister register_twice payload repeat",
    "rivals": "submit submit wait resize submit renew clear switch_bp repeat",
    "inactivity": "switch_bp submit register submit clear report payload records renew change_period wait",
    "streams": "stream submit wait renew stream clear",
    "sizes": "resize submit register submit wait renew switch_bp",
    "reception": "payload payload register payload records report change_network deregister wait repeat",
    "parameters": "change_period refuse resize refuse change_network change_neighbour_timeout change_vardis "
                  "submit register create report wait wait records",
    "neighbours": "report report age report change_neighbour_timeout age submit_safety_data wait repeat",
    "reports": "submit_safety_data submit_safety_data wait report repeat switch_bp submit",
    "services": "create update delete create wait records switch_vardis outlast repeat",
    "dissemination": "create records records delete wait outlast repeat",
    "timeouts": "create outlast records outlast wait update keep keep repeat",
    "limits": "change_vardis create update records wait shorten widen change_vardis",
    "crowds": "crowd narrow crowd wait create crowd change_vardis",
    "variable": "records records records records create update delete wait repeat",
    "own-variable": "create update update delete wait wait records repeat",
    "three protocols": "report records age create payload wait submit_safety_data",
    # A few of all.
    "everything": "",
}.items()}  # fmt: skip
_ONE: Final = ("variable", "own-variable")
_OFTEN: Final = {
    "variable": 8, "own-variable": 4, "dissemination": 2, "timeouts": 4, "limits": 4, "neighbours": 7, "everything": 8,
    "registrations": 3, "rivals": 3, "inactivity": 4, "sizes": 3, "reception": 5, "parameters": 2,
}  # fmt: skip
#: Themes by how often they are drawn: the states and events of one variable are more than those of all others.
_CHOSEN: Final = tuple(theme for theme in THEMES for _ in range(_OFTEN.get(theme, 1)))
#: How a sequence about one variable begins: by whom it was created, whether it was deleted, and whether time passed.
_BEGINNINGS: Final = tuple(
    (creator, deleted, later) for creator in ("", "node", "neighbour") for deleted in (False, True)
    for later in (False, True) if creator or not (deleted or later)
)  # fmt: skip
_QUEUES: Final = (QueueingMode.QUEUE_DROPTAIL, QueueingMode.QUEUE_DROPHEAD)
REGISTRATION: Final[dict[str, st.SearchStrategy[Any]]] = {
    "size": st.sampled_from((20, 20, 20, 300, 1, "largest", 100, 0, "above", "large", 20, (1 << 16) + 20)),
    "mode": st.sampled_from((*_QUEUES, QueueingMode.ONCE, QueueingMode.REPEAT)),
    "entries": st.sampled_from((1, 2, 3, 1, 3, 2, 1, 2, 3, 4, 300, 256, 0)),
    "several": st.booleans(),
    "name": st.sampled_from((4, 4, 4, 1, 40, 255)),
}
#: Faults and unusual traits of a beacon.
_UNUSUAL: Final = ("",) * 24 + tuple(FAULTS) + tuple(each for each in get_args(Trait) if each not in ("", *ENDS))
_SHAPES: Final = st.sampled_from(_UNUSUAL)
#: Parameters with values that no reading allows.
_INVALID: Final = st.sampled_from((
    ("BP", "BPPAR_BEACON_PERIOD", 0), ("BP", "BPPAR_BEACON_PERIOD", -100), ("BP", "BPPAR_MAXIMUM_PACKET_SIZE", 0),
    ("BP", "BPPAR_NETWORK_ID", -1), ("SRP", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", -1),
    ("VD", "VARDISPAR_MAX_REPETITIONS", 0), ("VD", "VARDISPAR_MAX_REPETITIONS", 16),
    ("VD", "VARDISPAR_MAX_VALUE_LENGTH", 0), ("VD", "VARDISPAR_MAX_DESCRIPTION_LENGTH", 0),
    ("VD", "VARDISPAR_MAX_SUMMARIES", -1), ("VD", "VARDISPAR_SCRUBBING_PERIOD", -1),
))  # fmt: skip
#: Octets of a value or payload: new ones, those before, or all the same.
_OCTETS: Final = st.sampled_from(("",) * 9 + ("again",) * 3 + ("zeros", "ones"))
_DATA: Final = st.sampled_from((*get_args(Data), "", "", ""))
_AGAIN: Final = st.sampled_from((False, False, False, True))
_TIMEOUTS: Final = st.sampled_from((0, 0, 5000, 300, 1200, 5000, 65000))
#: Records by what they say compared with what the node holds; more frequent ones several times.
RECORDS: Final = (
    "create: later", "create: later", "create: later", "create: same", "create: earlier", "create: own",
    "create: no value", "create: value too long", "create: no description", "create: description too long",
    "create: repCnt 0", "create: repCnt too large", "create: largest", "create: group", "create: zero", "create: other",
    "create: at 0",
    "delete", "delete",
    "update: newer", "update: newer", "update: older", "update: equal", "update: opposite", "update: no value",
    "update: value too long", "update: largest", "summary: newer", "summary: older", "summary: equal",
    "summary: opposite", "ask-update: older", "ask-update: equal", "ask-update: newer", "ask-create",
)  # fmt: skip
#: Events that do not renew a variable.
_KEEPING: Final = (
    "update: equal", "update: older", "summary: equal", "summary: newer", "create: same", "ask-update: older",
    "ask-create",
)  # fmt: skip
#: What is known of a variable that no step was about.
_NONE: Final = Knowledge()
#: Numbers of creations in the order of their times. From 8 on they are later than the variables of the node.
_CREATIONS: Final = (1, 2, 3, 4, 5, 6, 7, *range(9, 40))
#: Sizes of value and description by what is special about a record or a call.
_FLAWS: Final[dict[str, tuple[int | str, int | str]]] = {
    "no value": (0, 3), "value too long": ("above", 3), "no description": (2, 0), "description too long": (2, "above"),
    "largest": ("most", "most"), "shortest": (1, 1),
}  # fmt: skip
#: What a request can be refused for, beside another reason.
_REFUSED: Final = ("no value", "value too long", "description too long", "repCnt 0", "repCnt too large")
#: Numbers of variables at once: few, more than fit into a small payload, more than half of a container.
_CROWDS: Final = st.sampled_from((6, 30, 140, 200))


class Action(NamedTuple):
    """A kind of step: what draws its arguments, when it can have an effect, and the method that takes it."""

    arguments: st.SearchStrategy[dict[str, Any]]
    possible: Callable[[NodeMachine], bool]
    take: Callable[..., None]


ACTIONS: Final[dict[str, Action]] = {}
_Possible = Callable[["NodeMachine"], bool]


def action(possible: _Possible, **arguments: st.SearchStrategy[Any]) -> Callable[[Callable[..., None]], Any]:
    """Make an action of a method.

    Hypothesis would switch most of its own rules off in a sequence, which suits machines of which any few rules find
    something; here it takes four or five different ones.
    """

    def decorate(function: Callable[..., None]) -> Any:
        ACTIONS[function.__name__] = Action(st.fixed_dictionaries(arguments), possible, function)
        return function

    return decorate


class NodeMachine(RuleBasedStateMachine):
    """Draws a sequence, executes it on an implementation, and judges it with the model.

    Subclasses return the implementation from :meth:`open`; with :meth:`close` they take it back.
    """

    reached: ClassVar[Counter[tuple[str, str]]] = Counter()
    """The pairs (state of the model, event) of all sequences, with the number of their occurrences."""
    themes: ClassVar[tuple[str, ...]] = _CHOSEN
    """The themes of sequences, more frequent ones several times."""
    executed: ClassVar[Counter[str]] = Counter()
    """Number of sequences and steps."""

    def __init__(self) -> None:
        super().__init__()
        self.executor = self.open()
        self.driver = Driver(self.executor, self.reached)
        self.counterexample: Counterexample | None = None
        self._lost = False
        """Whether a call had no answer: the model does not know the state of the node from then on."""
        self._version = self.executor.codec.profile.spec_version
        self.title = ""
        """The theme of the sequence."""
        self._drawn: dict[str, dict[str, Any]] = {}
        """The arguments of each action when they were drawn last."""
        self._probes = False
        self.theme: tuple[str, ...] = tuple(ACTIONS)
        self._vardis = any(each.startswith("RTDB-") for each in self.executor.methods)

    @initialize(
        theme=st.sampled_from(_CHOSEN),
        beginning=st.sampled_from(_BEGINNINGS),
        registration=st.fixed_dictionaries(REGISTRATION),
        few=st.lists(st.integers(0, 99), min_size=3, max_size=6),
        probes=st.booleans(),
    )
    def about(
        self, theme: str, beginning: tuple[str, bool, bool], registration: dict[str, Any], few: list[int], probes: bool
    ) -> None:
        """Choose what the sequence is about, and begin. ``few``: actions; ``probes``: whether it ends with probes."""
        self._probes = probes
        theme = self.themes[_CHOSEN.index(theme) % len(self.themes)]
        self.title = theme
        self.theme = THEMES[theme] or tuple(tuple(ACTIONS)[each % len(ACTIONS)] for each in few)
        if theme in _ONE and self._vardis and self.executor.hears_vardis:
            self._begin(*beginning)
        elif theme == "timeouts" and self._vardis and self.executor.hears_vardis:
            self._begin(beginning[0] or "neighbour", beginning[1], beginning[2], timeout=1200)
        elif theme == "limits" and self._vardis and self.executor.hears_vardis:
            self.create(0, "", "most", 0, "")
            self.take(Beacon(0, (self._record("create: later", 1, 1, self._limit("most", "REPETITIONS"), 0),)))
            self.take(Wait(1))
        elif theme == "crowds" and self.executor.hears_vardis and self.executor.crowds > 32:
            self.crowd("create", 30 + few[0], ("most", 1)[few[1] % 2], 0, 1, 1 + few[2] % 30, uneven=True)
        elif theme == "rivals" and self.has("BP-RegisterProtocol"):
            # Payloads of which only one fits into a beacon.
            for mode in (registration["mode"], QueueingMode.QUEUE_DROPTAIL):
                self.register(**registration | {"size": "large", "mode": mode, "entries": 3})
        elif theme == "streams" and self.has("BP-RegisterProtocol") and self.executor.timing.whole:
            # More payloads than numPayloads can count.
            self.register(**registration | {"size": 1, "entries": 300, "several": True})
            self.take(Call("BP-TransmitPayload", {"protId": 0, "payload": 1}, 300))
        elif "register" in self.theme and self.has("BP-RegisterProtocol"):
            self.register(**registration)

    def _begin(self, creator: str, deleted: bool, later: bool, timeout: int = 0) -> None:
        """Bring the variable of the sequence into a state."""
        if creator == "node":
            self.create(0, "", 1, timeout, "")
        elif creator:
            self.take(Beacon(0, (self._record("create: later", 0, 1, 1, timeout),)))
        if deleted and creator == "node":
            self.delete(0)
        elif deleted:
            self.take(Beacon(0, (Records("delete", 0),)))
        if later:
            self.take(Wait(4))

    def _variable(self, number: int) -> int:
        """Return the number of a variable; 0 if the sequence is about one."""
        return 0 if self.title in _ONE else number

    @rule(data=st.data())
    def act(self, data: st.DataObject) -> None:
        """Take one of the actions of the theme that can have an effect now."""
        possible = [name for name in self.theme if ACTIONS[name].possible(self)]
        name = data.draw(st.sampled_from(possible or ("wait",)))
        if name not in self._drawn or not data.draw(_AGAIN):
            self._drawn[name] = data.draw(ACTIONS[name].arguments)
        ACTIONS[name].take(self, **self._drawn[name])

    def open(self) -> Executor:
        """Return an implementation in its initial state."""
        raise NotImplementedError

    def close(self, executor: Executor) -> None:
        """Release what :meth:`open` returned."""

    def take(self, step: Step) -> None:
        """Execute a step; none after a call that had no answer."""
        if self._lost:
            return
        self.executed["steps"] += 1
        try:
            self.driver.step(step)
        except (NoAnswerError, NeverAnsweredError):
            self._lost = True
        except Counterexample as found:
            self.counterexample = found
            raise

    def teardown(self) -> None:
        """Finish the sequence, unless it has ended with a counterexample."""
        self.executed["sequences"] += 1
        try:
            if self.counterexample is None and not self._lost:
                if self._probes:
                    self._probe()
                self.driver.finish()
        finally:
            self.close(self.executor)

    def _probe(self) -> None:
        """Take steps that show effects of earlier ones: services of each kind, and beacons to each client."""
        driver = self.driver
        for protocol, on in (("BP", driver.model.bp.active), ("VD", driver.model.vardis.active)):
            if not on and self.can_switch(protocol):
                self.take(Call(f"{protocol}-MGMT-Activate"))
        if driver.model.values["BPPAR_MAXIMUM_PACKET_SIZE"] != driver.initial["BPPAR_MAXIMUM_PACKET_SIZE"]:
            self.resize("initial")
        for number, client in self.registrations().items():
            self.take(Call("BP-TransmitPayload", {"protId": number, "payload": min(4, client.most)}))
        if driver.protocols:
            self.take(Beacon(2, tuple(Client(number, 4) for number in sorted(driver.protocols))))
        if driver.model.srp.watched:
            self.report(1, 0, "next", 1, False, 0, None, "", "")
        if driver.model.vardis.mine and self.executor.hears_vardis:
            self.records(2, 0, [("summary: older", 0, 1, 1, 0, ""), ("ask-create", 0, 1, 1, 0, "")], "")
            if self._vardis:
                self.update(0, 2, 1, "")
            self.take(Wait(2))
            self.records(2, 0, [("summary: newer", 0, 1, 1, 0, "")], "")

    # -- what there is ---------------------------------------------------------------------------------------

    def has(self, method: str) -> bool:
        """Return whether the upper tester has a method."""
        return method in self.executor.methods

    def can_switch(self, protocol: str) -> bool:
        """Return whether the sequence may deactivate a protocol, and can activate it again."""
        both = self.has(f"{protocol}-MGMT-Deactivate") and self.has(f"{protocol}-MGMT-Activate")
        return both and self.executor.alone

    def registrations(self) -> dict[int, Registration]:
        """Return the registrations by the numbers of the sequence."""
        clients = self.driver.model.bp.clients
        return {number: clients[prot] for number, prot in self.driver.protocols.items() if prot in clients}

    @property
    def registered(self) -> bool:
        """Whether there is a registration."""
        return bool(self.driver.model.bp.clients)

    # -- BP --------------------------------------------------------------------------------------------------

    @action(lambda self: self.has("BP-RegisterProtocol") and len(self.registrations()) < _CLIENTS, **REGISTRATION)
    def register(self, **what: Any) -> None:
        """Register a client protocol that is not registered."""
        taken = self.registrations()
        self.take(self._registration(next(each for each in range(_CLIENTS) if each not in taken), **what))

    @action(lambda self: self.registered, which=WHICH, **REGISTRATION)
    def register_twice(self, which: int, **what: Any) -> None:
        """Register a client protocol that is registered."""
        self.take(self._registration(self._one_of(which), **what))

    @action(lambda self: self.registered, which=WHICH, **REGISTRATION)
    def renew(self, which: int, **what: Any) -> None:
        """Deregister a client protocol, and register it differently."""
        number = self._one_of(which)
        self.take(Call("BP-DeregisterProtocol", {"protId": number}))
        self.take(self._registration(number, **what))

    def _one_of(self, which: int) -> int:
        """Return the number of a registered protocol, or of one that is not registered."""
        there = sorted(self.registrations())
        return _CLIENTS if which == _ABSENT else there[which % len(there)]

    def _registration(
        self, number: int, size: int | str, mode: QueueingMode, entries: int, several: bool, name: int
    ) -> Call:
        largest = self.driver.model.bp.largest
        most = {"largest": largest, "above": largest + 1, "large": 3 * largest // 5}.get(str(size), size)
        if self._version < SpecVersion.V1_1:
            mode = QueueingMode.QUEUE if mode in _QUEUES else mode
        params: dict[str, Any] = {"protId": number, "name": name, "maxPayloadSize": most, "queueingMode": mode.value}
        if self._version >= SpecVersion.V1_1:
            params |= {"maxEntries": entries, "allowMultiplePayloads": several}
        return Call("BP-RegisterProtocol", params)

    @action(lambda self: self.registered, which=ANY)
    def deregister(self, which: int) -> None:
        """Deregister a client protocol."""
        self.take(Call("BP-DeregisterProtocol", {"protId": self._one_of(which)}))

    @action(
        lambda self: self.registered, which=ANY,
        size=st.sampled_from(("usual", "most", "usual", "most", "above", "usual", "one", "empty", "half", "wraps")),
        times=st.sampled_from((1, "fill", 2, 1, "fill", 3)), contents=_OCTETS,
    )  # fmt: skip
    def submit(self, which: int, size: str, times: int | str, contents: str) -> None:
        """Submit payloads."""
        number = self._one_of(which)
        client = self.registrations().get(number)
        most = 20 if client is None else client.most
        octets = {
            "usual": min(4, most), "most": most, "above": most + 1, "empty": 0, "one": 1, "half": most // 2 + 1,
            # The low octet of this length is a permitted length.
            "wraps": most + 256,
        }[size]  # fmt: skip
        if times == "fill":
            times = client.entries + 1 if client is not None and client.mode in _QUEUES else 2
        params = {"protId": number, "payload": octets} | _contents(contents)
        self.take(Call("BP-TransmitPayload", params, int(times)))

    @action(
        lambda self: self.registered and self.executor.timing.whole, which=WHICH,
        count=st.sampled_from((12, 12, 30, 100)), pause=st.sampled_from((0.4, 1.0, 0.4)),
    )  # fmt: skip
    def stream(self, which: int, count: int, pause: float) -> None:
        """Submit payloads in succession, where time costs nothing."""
        number = self._one_of(which)
        size = min(4, self.registrations()[number].most)
        for _ in range(count):
            self.take(Call("BP-TransmitPayload", {"protId": number, "payload": size}))
            self.take(Wait(pause))

    @action(lambda self: self.has("BP-ClearBuffer") and self.registered, which=ANY)
    def clear(self, which: int) -> None:
        """Clear the buffer of a client protocol."""
        self.take(Call("BP-ClearBuffer", {"protId": self._one_of(which)}))

    @action(lambda self: self.can_switch("BP"))
    def switch_bp(self) -> None:
        """Deactivate BP, or activate it again."""
        on = self.driver.model.bp.active
        self.take(Call(f"BP-MGMT-{'Deactivate' if on else 'Activate'}"))

    @action(
        lambda self: self.has("BP-RegisterProtocol"), sender=NEIGHBOURS, number=PROTOCOLS,
        size=st.sampled_from((4, 1, 20, 4, 0, "most", 900)), count=st.sampled_from((1, 1, 1, 1, 2, 140)),
        octets=_OCTETS, before=st.lists(st.sampled_from((0, 1, 2, 3, 4, 5, "report", "record", "long")), max_size=4),
        shape=st.sampled_from((*_UNUSUAL, *ENDS)),
    )  # fmt: skip
    def payload(
        self, sender: int, number: int, size: int | str, count: int, octets: str, before: list[int | str], shape: str
    ) -> None:
        """Send payloads to a client protocol, several times in faulty beacons. ``before``: other blocks."""
        client = self.registrations().get(number)
        most = int(size) if size != "most" else client.most if client is not None else 20
        # As far as they fit.
        most = min(most, max(900 - 264 * before.count("long"), 0) // count)
        blocks = [] if shape in FAULTS else [self._block(each, plain=shape in ENDS) for each in before]
        if shape in ENDS:
            blocks.append(Client(number, 5))
        blocks.append(Client(number, most, count, **_contents(octets)))
        if not most:
            # An empty block does not hide the next one.
            blocks.append(Client(number, 4))
        for _ in range(4 if shape in FAULTS else 1):
            self.take(_beacon(sender, tuple(blocks), shape))

    def _block(self, what: int | str, *, plain: bool) -> Content:
        """Return a block for a protocol of this number, or of SRP or VarDis unless it must be ``plain``."""
        if what == "long":
            # For a protocol that is rarely registered; its length has a high octet.
            return Client(4, 260 if not plain else 40)
        if isinstance(what, int) or plain or (what == "record" and not self.executor.hears_vardis):
            return Client(what if isinstance(what, int) else 1, 4)
        return Report(0, 5) if what == "report" else self._record("create: later", 0, 1, 1, 0)

    # -- parameters ------------------------------------------------------------------------------------------

    @action(
        lambda self: self.has("BP-SetParameter") and self.executor.alone,
        value=st.sampled_from(("initial", 120, 200, 300, "least")),
    )
    def resize(self, value: int | str) -> None:
        """Set the maximum packet size."""
        model = self.driver.model
        initial = self.driver.initial["BPPAR_MAXIMUM_PACKET_SIZE"]
        least = self.driver.least_packet
        size = initial if value == "initial" else least if value == "least" else min(int(value), initial)
        if size != model.values["BPPAR_MAXIMUM_PACKET_SIZE"]:
            self._set("BP", "BPPAR_MAXIMUM_PACKET_SIZE", size)

    @action(
        lambda self: self.has("BP-SetParameter") and self.executor.alone,
        factor=st.sampled_from((1, 2, 4, 0.25, 700, 0.5, 0.37, 19)),
    )  # fmt: skip
    def change_period(self, factor: float) -> None:
        """Set the beacon period, beyond 16 bits where time costs nothing."""
        factor = min(factor, 700 if self.executor.timing.whole else 4)
        self._set("BP", "BPPAR_BEACON_PERIOD", int(self.driver.initial["BPPAR_BEACON_PERIOD"] * factor) or 1)
        if self.driver.model.bp.active and self.executor.timing.whole:
            # Until the mean is known.
            self.take(Wait(30 * min(max(factor, 1), 20)))

    @action(lambda self: self.executor.alone, invalid=_INVALID)
    def refuse(self, invalid: tuple[str, str, int]) -> None:
        """Set a parameter to an invalid value, which must not have any effect."""
        protocol, name, value = invalid
        if self.has(f"{protocol}-SetParameter") and name in self.driver.initial:
            self._set(protocol, name, value)

    @action(
        lambda self: self.has("BP-SetParameter") and self.executor.alone,
        value=st.sampled_from(("initial", 0, 1, 65535)),
    )
    def change_network(self, value: int | str) -> None:
        """Set the network identifier."""
        if "BPPAR_NETWORK_ID" not in self.driver.initial:
            return
        self._set("BP", "BPPAR_NETWORK_ID", self.driver.initial["BPPAR_NETWORK_ID"] if value == "initial" else value)

    @action(
        lambda self: self.has("SRP-SetParameter") and self.executor.alone,
        value=st.sampled_from((3000, 1000, 300, 20000, 40000, 65535, 70000)),
    )
    def change_neighbour_timeout(self, value: int) -> None:
        """Set the timeout of neighbours."""
        self._set("SRP", "SRPPAR_NEIGHBOUR_TABLE_TIMEOUT", value)

    @action(
        lambda self: self._vardis and self.has("VD-SetParameter") and self.executor.alone,
        what=st.sampled_from(
            ("SUMMARIES", "REPETITIONS", "VALUE_LENGTH", "DESCRIPTION_LENGTH", "PAYLOAD_SIZE", "SCRUB")
        ),
        value=st.sampled_from((1, 2, 15, "initial", 200, 255, 0)), after=st.sampled_from(("", "back", "ask", "wait")),
    )  # fmt: skip
    def change_vardis(self, what: str, value: int | str, after: str = "") -> None:
        """Set a parameter of VarDis; sometimes for a while only, or ask for records of variables after it."""
        model = self.driver.model
        name = "VARDISPAR_SCRUBBING_PERIOD" if what == "SCRUB" else f"VARDISPAR_MAX_{what}"
        if name not in self.driver.initial:
            return
        number = int(self.driver.initial[name] if value == "initial" else value)
        if what == "PAYLOAD_SIZE":
            # A node may refuse one that does not fit into a packet, or set a smaller one (X39).
            number = min(max(number, model.least_payload), self.driver.initial[name], model.free)
        elif what == "SCRUB":
            number = {1: 100, 2: 300, 15: 1000, 200: 2000, 255: 3000}.get(number, 1000)
        number = model.bounded(name, number)
        self._set("VD", name, number)
        if after in ("back", "wait"):
            self.take(Wait(3))
        if after == "back":
            self._set("VD", name, int(self.driver.initial[name]))
        if after == "ask" and self.executor.hears_vardis:
            asked = ((event, each) for each in range(2) for event in ("ask-create", "summary: older"))
            self.take(Beacon(2, tuple(self._record(event, each, 1, 1, 0) for event, each in asked)))

    @action(lambda self: self._vardis and self.has("VD-SetParameter") and self.executor.alone)
    def shorten(self) -> None:
        """Set the limits of a variable below what the node holds."""
        for what in ("VALUE_LENGTH", "DESCRIPTION_LENGTH", "REPETITIONS"):
            self._set("VD", f"VARDISPAR_MAX_{what}", 1)

    @action(
        lambda self: self._vardis and self.has("VD-SetParameter") and self.executor.alone, number=VARIABLES,
        first=st.sampled_from(("VALUE_LENGTH", "DESCRIPTION_LENGTH")), by_node=st.booleans(),
    )  # fmt: skip
    def widen(self, number: int, first: str, by_node: bool) -> None:
        """Set the limits of a variable as far as they go, one first, and create and update a variable of that size."""
        model = self.driver.model
        for what in (first, "VALUE_LENGTH", "DESCRIPTION_LENGTH"):
            self._set("VD", f"VARDISPAR_MAX_{what}", model.bounded(f"VARDISPAR_MAX_{what}", 255))
        if by_node:
            self.create(number, "largest", 1, 0, "")
            self.update(number, "most", 1, "")
        elif self.executor.hears_vardis:
            for event in ("create: largest", "update: largest"):
                self.take(Beacon(0, (self._record(event, self._variable(number), 1, 1, 0),)))

    @action(lambda self: self._vardis and self.has("VD-SetParameter") and self.executor.alone)
    def narrow(self) -> None:
        """Make payloads as small as possible."""
        for what in ("VALUE_LENGTH", "DESCRIPTION_LENGTH"):
            self._set("VD", f"VARDISPAR_MAX_{what}", 1)
        self._set("VD", "VARDISPAR_MAX_SUMMARIES", 1)
        self._set("VD", "VARDISPAR_MAX_PAYLOAD_SIZE", self.driver.model.least_payload)

    def _set(self, protocol: str, name: str, value: Any) -> None:
        if name != "VARDISPAR_MAX_PAYLOAD_SIZE" or self.driver.model.least_payload <= self.driver.model.free:
            self.take(Call(f"{protocol}-SetParameter", {"name": name, "value": value}))

    # -- SRP -------------------------------------------------------------------------------------------------

    @action(
        lambda self: self.has("SRP-UpdateSafetyData"), times=st.sampled_from((1, 2)),
        pause=st.sampled_from((0, 0.4, 2)), data=_DATA,
    )  # fmt: skip
    def submit_safety_data(self, times: int, pause: float, data: Data) -> None:
        """Submit safety data."""
        for _ in range(times):
            if pause:
                self.take(Wait(pause))
            self.take(Call("SRP-UpdateSafetyData", {DATA: data} if data else {}))

    @action(
        lambda self: self.has("SRP-NeighbourTable"), sender=NEIGHBOURS,
        neighbour=st.sampled_from((0, 0, 0, 0, 1, 1, 2, 2, 3, 3, OWN, OWN, GROUP, ZERO)),
        seqno=st.sampled_from(("next", 5, "next", "same", 6, 0, 20_000, "next", (1 << 32) - 1, "before", 70_000)),
        count=st.sampled_from((1, 1, 1, 1, 1, 1, 1, 2, 12, 140)),
        earlier=_AGAIN, excess=st.sampled_from((0,) * 14 + (1, -1, -4, -12, 4, 42)),
        beside=st.sampled_from((None,) * 8 + (0, 1, 2)), shape=_SHAPES, data=_DATA,
    )  # fmt: skip
    def report(
        self, sender: int, neighbour: int, seqno: int | str, count: int, earlier: bool, excess: int,
        beside: int | None, shape: str, data: Data,
    ) -> None:  # fmt: skip
        """Send state reports, sometimes two in a beacon. ``seqno``: a number, or how it follows the one before."""
        if isinstance(seqno, str):
            known = self.driver.model.srp.table.get(self.executor.names.neighbour(max(neighbour, 0))[0])
            before = known[-1].seqno if known else 4
            seqno = max(before + {"next": 1, "same": 0, "before": -1}[seqno], 0) % (1 << 32)
        reports = [Report(neighbour, seqno, 1 if neighbour < 0 else count, earlier, excess, data)]
        if beside is not None and count == 1 and beside != neighbour:
            reports.append(Report(beside, seqno))
        # A record that is discarded must not prolong an entry, however often it comes.
        for _ in range(3 if excess else 1):
            self.take(_beacon(sender, tuple(reports), shape))
            if excess:
                self.take(Wait(round(0.5 * self.driver.model.srp.timeout / self.executor.timing.period, 1)))

    # -- VarDis ----------------------------------------------------------------------------------------------

    @action(
        lambda self: self._vardis, number=VARIABLES,
        what=st.sampled_from(("",) * 6 + (*_FLAWS, "repCnt 0", "repCnt too large")),
        more=st.sampled_from(("",) * 7 + _REFUSED),
        repetitions=st.sampled_from((1, 1, "most", "most")), timeout=_TIMEOUTS, octets=_OCTETS,
    )  # fmt: skip
    def create(self, number: int, what: str, repetitions: int | str, timeout: int, octets: str, more: str = "") -> None:
        """Create a variable of the node. ``more``: a second flaw of the request."""
        size, descr = _FLAWS.get(what, (2, 3))
        if more:
            size, descr = (
                other if other not in (2, 3) else one
                for one, other in zip((size, descr), _FLAWS.get(more, (2, 3)), strict=True)
            )
        count = 0 if "repCnt 0" in (what, more) else "above" if "repCnt too large" in (what, more) else repetitions
        params = {
            "varId": self._variable(number),
            "repCnt": self._limit(count, "REPETITIONS"),
            "descr": self._limit(descr, "DESCRIPTION_LENGTH"),
            "value": self._limit(size, "VALUE_LENGTH"),
        }
        if self._version >= SpecVersion.V2_0:
            params["timeout"] = timeout
        self.take(Call("RTDB-Create", params | _contents(octets)))

    @action(
        lambda self: self._vardis, number=VARIABLES, size=st.sampled_from((2, 2, 2, "most", 1, "above", 0)),
        times=st.sampled_from((1,) * 12 + (2,) * 6 + (260,)), octets=_OCTETS,
    )  # fmt: skip
    def update(self, number: int, size: int | str, times: int, octets: str) -> None:
        """Update a variable."""
        params = {"varId": self._variable(number), "value": self._limit(size, "VALUE_LENGTH")}
        params |= _contents(octets)
        self.take(Call("RTDB-Update", params, times))

    @action(lambda self: self._vardis, number=VARIABLES)
    def delete(self, number: int) -> None:
        """Delete a variable."""
        self.take(Call("RTDB-Delete", {"varId": self._variable(number)}))

    @action(lambda self: self.can_switch("VD"))
    def switch_vardis(self) -> None:
        """Deactivate VarDis, or activate it again."""
        on = self.driver.model.vardis.active
        self.take(Call(f"VD-MGMT-{'Deactivate' if on else 'Activate'}"))

    @action(
        lambda self: self.executor.hears_vardis, sender=NEIGHBOURS, number=VARIABLES,
        events=st.lists(st.tuples(
            st.sampled_from(RECORDS), st.sampled_from((0, 0, 0, 0, 0, 0, 1, 2)),
            st.sampled_from((1, 1, 1, 2, "quarter", "most")), st.sampled_from((1, 1, "most", "most")), _TIMEOUTS,
            _OCTETS,
        ), min_size=1, max_size=3),
        shape=_SHAPES, damaged=st.sampled_from((0,) * 12 + (1, 9)),
    )  # fmt: skip
    def records(self, sender: int, number: int, events: list[Any], shape: str, damaged: int = 0) -> None:
        """Send instructions, mostly about one variable, each with at most one flaw.

        ``damaged``: number of damaged payloads that the neighbour sends before.
        """
        for _ in range(damaged):
            self.take(Beacon(sender, (Damaged(),)))
        blocks = [
            self._record(
                event, self._variable(number + further), far, self._limit(repetitions, "REPETITIONS"), timeout, octets
            )
            for event, further, far, repetitions, timeout, octets in events
        ]
        self.take(_beacon(sender, tuple(blocks), shape))

    def _record(
        self, event: str, number: int, far: int | str, repetitions: int, timeout: int, octets: str = ""
    ) -> Records:
        """Return a record that is related as ``event`` says to what the node holds.

        ``far``: distance of its number on the circle.
        """
        model, names = self.driver.model.vardis, self.executor.names
        circle = 1 << 8 * self.executor.codec.profile.types.var_seqno.width
        distance = far if isinstance(far, int) else {"quarter": circle // 4, "most": circle // 2 - 1}[far]
        kind, _, what = event.partition(": ")
        known = model.variables.get(names.variable(number))
        seqno = 0 if known is None else known.now.seqno
        if kind == "create":
            latest = NO_CREATION if known is None else known.latest
            later = next((each for each in _CREATIONS if names.creation(each) > latest), _CREATIONS[-1])
            creation = EPOCH if what == "at 0" else max(later - {"same": 1, "earlier": 2}.get(what, 0), 0)
            seqno = {1: 0, 2: 1}.get(distance, circle - 1)
        else:
            seqno += {"newer": distance, "older": -distance, "opposite": circle // 2, "equal": 0}.get(what, distance)
            creation = 0
        size, descr = _FLAWS.get(what, (2, 3))
        if what.startswith("repCnt"):
            repetitions = 0 if what == "repCnt 0" else self._limit("above", "REPETITIONS")
        return Records(
            cast("RecordKind", kind), number, 1, seqno % circle, self._limit(size, "VALUE_LENGTH"),
            self._limit(descr, "DESCRIPTION_LENGTH"), repetitions,
            {"own": OWN, "group": GROUP, "zero": ZERO, "other": 1}.get(what, 0), creation, timeout, **_contents(octets),
        )  # fmt: skip

    @action(
        lambda self: self.executor.hears_vardis and self.executor.crowds > 32,
        kind=st.sampled_from(("create", "summary", "delete", "update", "ask-create")), count=_CROWDS,
        repetitions=st.sampled_from((1, "most")), seqno=st.sampled_from((0, 1)), creation=st.sampled_from((1, 2)),
        descr=st.sampled_from((1, 2, 6, 7, 12, 19, 28)), uneven=st.booleans(),
    )  # fmt: skip
    def crowd(
        self, kind: Any, count: int, repetitions: int | str, seqno: int, creation: int, descr: int, uneven: bool
    ) -> None:
        """Send instructions about many variables. ``uneven``: of different sizes, so that only some fit."""
        count = min(count, self.executor.crowds - 8)
        size = self._limit("most", "VALUE_LENGTH") if uneven else 1
        descr = self._limit(descr, "DESCRIPTION_LENGTH")
        repetitions = self._limit(repetitions, "REPETITIONS")
        record = Records(kind, 6, count, seqno, size, descr, repetitions, 0, creation, uneven=uneven)
        self.take(Beacon(0, (record,)))

    def _limit(self, size: int | str, name: str) -> int:
        """Return a size, or one at the limit of a parameter."""
        most = int(self.driver.model.values[f"VARDISPAR_MAX_{name}"])
        if size == "most":
            return min(most, 255)
        if size == "above":
            return min(most + 1, 255)
        return min(int(size), max(most, 1))

    @action(lambda self: bool(self.driver.model.srp.table), part=st.sampled_from((1.4, 0.9, 0.5, 1.4)))
    def age(self, part: float) -> None:
        """Let a part of the timeout of neighbours pass."""
        self.take(Wait(round(part * self.driver.model.srp.timeout / self.executor.timing.period + 1, 1)))

    @action(lambda self: self.driver.model.vardis.next_timeout is not None, part=st.sampled_from((1.1, 0.9, 1.1, 1.7)))
    def outlast(self, part: float) -> None:
        """Let a part of the timeout of a variable pass, and a scrubbing."""
        due = self.driver.model.vardis.next_timeout or 0
        left = max(due - self.executor.now(), 0)
        scrub = self.driver.model.values.get("VARDISPAR_SCRUBBING_PERIOD", 1000) * 1_000_000
        duration = left * part + (1.5 * scrub if part > 1 else 0)
        self.take(Wait(round(duration / self.executor.timing.period + 1, 1)))

    @action(
        lambda self: self._next_to_expire() is not None and self.executor.hears_vardis,
        event=st.sampled_from(("update: newer", "update: newer", "application", *_KEEPING)),
        times=st.sampled_from((1, 2)),
    )  # fmt: skip
    def keep(self, event: str, times: int) -> None:
        """Let most of the timeout of a variable pass, change it or not, and again: an update restarts the timeout."""
        number = self._next_to_expire() or 0
        known = self.driver.model.vardis.variables[self.executor.names.variable(number)]
        timeout = known.now.spec.timeout or 0 if known.now.spec is not None else 0
        pause = Wait(round(0.8 * timeout * 1_000_000 / self.executor.timing.period, 1))
        for _ in range(times):
            self.take(pause)
            if event == "application" and self._vardis:
                self.update(number, 2, 1, "")
            elif event != "application":
                self.take(Beacon(0, (self._record(event, number, 1, 1, timeout),)))
        self.take(pause)

    def _next_to_expire(self) -> int | None:
        """Return the number of the variable whose timeout is next; None if it is not one of the first."""
        model, names = self.driver.model.vardis, self.executor.names
        due = model.next_timeout
        first = {names.variable(number): number for number in range(5)} if due is not None else {}
        return next((number for each, number in first.items() if model.variables.get(each, _NONE).due == due), None)

    # -- time ------------------------------------------------------------------------------------------------

    @action(
        lambda self: any(not isinstance(each, Wait) for each in self.driver.steps[-6:]),
        back=st.sampled_from((0, 0, 1, 2)), times=st.sampled_from((1, 2, 1, 12)),
        pause=st.sampled_from((0, 1, 0.4, 4)),
    )  # fmt: skip
    def repeat(self, back: int, times: int, pause: float) -> None:
        """Take one of the last steps again, with pauses: also for longer than a timeout."""
        last = [each for each in self.driver.steps[-6:] if not isinstance(each, Wait)][::-1]
        step = last[back % len(last)]
        for _ in range(times):
            self.take(step)
            if pause:
                self.take(Wait(pause))

    @action(lambda _: True, periods=PERIODS)
    def wait(self, periods: float) -> None:
        """Let time pass."""
        self.take(Wait(periods))


def _beacon(sender: int, blocks: tuple[Content, ...], shape: str) -> Beacon:
    """Return a beacon with a fault or an unusual trait."""
    if shape in FAULTS:
        return Beacon(sender, blocks, fault=cast("Fault", shape))
    return Beacon(sender, blocks, trait=cast("Trait", shape))


def _contents(octets: str) -> dict[str, Any]:
    """Return the parameters of a call, or fields of a block, for these octets."""
    return {AGAIN: True} if octets == "again" else {FILL: octets} if octets else {}
