"""Several nodes over a simulated broadcast: whatever is lost, doubled or cut off, all nodes agree again.

A rule-based state machine drives two to four nodes. Invariants hold after every step: no node has a newer value than
the producer. ``heal`` ends a history: all links work, and after a bounded number of rounds every live variable must
have its producer's value at every node.

Only cases in which the specification itself prevents convergence are left out (A.7 of the protocol reference):

* H1 is noise, not divergence; the number of rounds allows for it.
* H2: a node that has restarted forgets its variables and ignores creations of its own. They need not converge. It asks
  for them with every summary, and the answers to it go before updates: in small payloads these would starve.
  So payloads have room for all variables once a node has restarted.
* H3: deletions have no creation time and no check of the producer, timeouts are local, and a deleted variable stays so
  until a later creation. A variable with a timeout need not converge where it is deleted while its producer has it.
* H4, H5: identifiers belong to one node each, so no node takes over another's. Clocks are skewed and set back and
  forth, but one node's creations of a variable are in order. A restarted node does not use its old identifiers.
* Creating again: summaries and updates have no creation time. A node that knows an earlier creation and misses all
  repetitions of the new VarCreate never asks for it, confuses sequence numbers of both creations, and forwards values
  of the old one to nodes that may treat them as newer. So a variable that was created again while other nodes knew it,
  or while instructions about it were under way, need not converge (``tainted``); it does if no node knew it.
* A consumer that misses half the number space takes old for new (C.1). Histories hold fewer updates than that.
"""

from __future__ import annotations

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, initialize, invariant, precondition, rule

from dcp_stack.config import NodeConfig, VardisConfig
from dcp_stack.effects import Dropped, VariableChanged
from dcp_stack.vardis.entity import Vardis

from ...chance import examples
from ..vardis_rig import MS, WALL, OneSlot, Rig

PERIOD = 100 * MS
IDS_PER_NODE = 6
SMALL_PAYLOAD = 120  # of which a VarCreate takes up to 48
ROOM_FOR_ALL = 1400


class Peer:
    """A node with a fake BP; its clocks run beside those of others."""

    def __init__(self, index: int, codec, wall_skew: int) -> None:
        self.index = index
        self.own_id = bytes([2, 0, 0, 0, 0, index])
        self.codec = codec
        self.wall_skew = wall_skew
        self.effects: list = []
        self.fresh_id = index * 64
        self.start(0)

    def start(self, now: int) -> None:
        self.bp = OneSlot(self.own_id)
        config = NodeConfig(
            node_id=self.own_id,
            codec=self.codec,
            # Small, so that not everything fits at once.
            vardis=VardisConfig(
                max_payload_size=SMALL_PAYLOAD,
                max_value_length=20,
                max_description_length=8,
                max_summaries=3,
                max_repetitions=4,
            ),
        )
        self.vardis = Vardis(config, self.bp, emit=self.effects.append, now=now, wall=self.wall(now))
        self.vardis.start(now, self.wall(now))

    def wall(self, now: int) -> int:
        return WALL + now + self.wall_skew

    def beacon(self, now: int) -> bytes | None:
        self.vardis.handle_timeout(now, self.wall(now))
        payload = self.bp.take()
        self.vardis.payload_transmitted(now, self.wall(now))
        assert payload is None or len(payload) <= self.vardis.parameters()["VARDISPAR_MAX_PAYLOAD_SIZE"]
        return payload

    def entry(self, var_id: int):
        return self.vardis.describe_variable(var_id).entry


class Network(RuleBasedStateMachine):
    """Nodes exchange payloads in rounds; before a ``heal`` anything can go wrong."""

    version = "2.0"

    @initialize(
        count=st.integers(2, 4),
        skews=st.lists(st.integers(-(10**13), 10**13), min_size=4, max_size=4),
    )
    def build(self, count: int, skews: list[int]) -> None:
        codec = Rig(self.version).codec
        self.now = 0
        self.peers = [Peer(index, codec, skews[index]) for index in range(count)]
        self.blocked: set[tuple[int, int]] = set()
        self.owners: dict[int, Peer] = {}
        #: (variable, creation time) -> the values by sequence number that its producer gave it
        self.history: dict[tuple[int, int | None], list[bytes]] = {}
        self.orphans: set[int] = set()
        self.tainted: set[int] = set()
        self.delayed: list[tuple[int, bytes]] = []
        # More than a payload holds, and known to all.
        for peer in self.peers:
            for rep_cnt in (1, 2, 4)[: 6 // count]:
                self.new_variable(peer, peer.fresh_id, rep_cnt, 0)
        self.heal()

    # -- applications -------------------------------------------------------------------------------------------

    @rule(
        which=st.integers(0, 3),
        rep_cnt=st.integers(1, 4),
        timeout=st.sampled_from((0, 0, 0, 300, 2000)),
        data=st.data(),
    )
    def create(self, which: int, rep_cnt: int, timeout: int, data: st.DataObject) -> None:
        peer = self.peer(which)
        own = [var_id for var_id, owner in self.owners.items() if owner is peer and var_id not in self.orphans]
        fresh = peer.fresh_id
        var_id = data.draw(st.sampled_from([*own, fresh])) if own else fresh
        known = peer.entry(var_id)
        if self.version != "2.0":
            timeout = 0
            if known is not None or var_id != fresh:
                return
        if var_id == fresh and (len(own) >= IDS_PER_NODE or fresh >= peer.index * 64 + 60):
            return
        self.new_variable(peer, var_id, rep_cnt, timeout)

    @precondition(lambda self: self.own_alive())
    @rule(data=st.data())
    def update(self, data: st.DataObject) -> None:
        for var_id in data.draw(st.lists(st.sampled_from(self.own_alive()), min_size=1, max_size=6)):
            peer = self.owners[var_id]
            values = self.history[var_id, peer.entry(var_id).spec.creation_time]
            if len(values) < 100:
                values.append(self.value())
                assert peer.vardis.update(var_id, values[-1], now=self.now, wall=peer.wall(self.now)).status.is_ok

    @precondition(lambda self: self.own_alive())
    @rule(data=st.data())
    def delete(self, data: st.DataObject) -> None:
        var_id = data.draw(st.sampled_from(self.own_alive()))
        peer = self.owners[var_id]
        assert peer.vardis.delete(var_id, now=self.now, wall=peer.wall(self.now)).status.is_ok
        if self.version != "2.0":
            # Nothing tells what was deleted from what comes after: identifiers are used once.
            self.orphans.add(var_id)

    def new_variable(self, peer: Peer, var_id: int, rep_cnt: int, timeout: int) -> None:
        known = peer.entry(var_id)
        peer.fresh_id = max(peer.fresh_id, var_id + 1)
        if known is not None and self.is_known_elsewhere(var_id, peer):
            self.tainted.add(var_id)
        value = self.value()
        status = peer.vardis.create(
            var_id, None, rep_cnt, b"d%d" % peer.index, value, timeout, now=self.now, wall=peer.wall(self.now)
        ).status
        assert status.is_ok, status
        self.owners[var_id] = peer
        entry = peer.entry(var_id)
        self.history[var_id, entry.spec.creation_time] = [value]
        if known is not None:
            assert entry.spec.creation_time > known.spec.creation_time

    # -- what goes wrong ----------------------------------------------------------------------------------------

    @rule(which=st.integers(0, 3), lost=st.sets(st.integers(0, 3)), doubled=st.booleans(), delayed=st.booleans())
    def beacon(self, which: int, lost: set[int], doubled: bool, delayed: bool) -> None:
        sender = self.peer(which)
        self.now += PERIOD // len(self.peers)
        payload = sender.beacon(self.now)
        if payload is None:
            return
        for peer in self.peers:
            if peer is sender or (sender.index, peer.index) in self.blocked or peer.index in lost:
                continue
            self.deliver(peer, payload)
            if doubled:
                self.deliver(peer, payload)
            if delayed:
                self.delayed.append((peer.index, payload))

    @precondition(lambda self: self.delayed)
    @rule(data=st.data())
    def deliver_late(self, data: st.DataObject) -> None:
        index, payload = self.delayed.pop(data.draw(st.integers(0, len(self.delayed) - 1)))
        self.deliver(self.peers[index], payload)

    @rule(group=st.sets(st.integers(0, 3)))
    def partition(self, group: set[int]) -> None:
        self.blocked = {
            (a.index, b.index) for a in self.peers for b in self.peers if (a.index in group) != (b.index in group)
        }

    @rule(count=st.integers(1, 6))
    def rounds_go_by(self, count: int) -> None:
        for _ in range(count):
            self.round()

    @precondition(lambda self: self.own_alive())
    @rule(data=st.data(), group=st.sets(st.integers(0, 3)), count=st.integers(5, 8))
    def update_while_cut_off(self, data: st.DataObject, group: set[int], count: int) -> None:
        """All repetitions of an update get to a part of the network only."""
        self.partition(group)
        self.update(data)
        self.rounds_go_by(count)

    @rule(milliseconds=st.sampled_from((1, 50, 400, 3000)))
    def time_passes(self, milliseconds: int) -> None:
        self.now += milliseconds * MS
        for peer in self.peers:
            peer.vardis.handle_timeout(self.now, peer.wall(self.now))

    @rule(which=st.integers(0, 3), data=st.data())
    def something_happens(self, which: int, data: st.DataObject) -> None:
        match data.draw(st.sampled_from(("restart", "clock", "noise", "inactive"))):
            case "restart":
                self.restart(which)
            case "clock":
                self.peer(which).wall_skew += data.draw(st.integers(-(10**12), 10**12))
            case "noise":
                # Containers that are well formed could lie about other nodes' variables: only broken ones are noise.
                self.deliver(self.peer(which), b"\x09" + data.draw(st.binary(max_size=40)))
            case "inactive":
                self.inactive_for_a_while(which, data.draw(st.integers(1, 8)))

    def restart(self, which: int) -> None:
        peer = self.peer(which)
        self.orphans |= {var_id for var_id, owner in self.owners.items() if owner is peer}  # H2
        peer.start(self.now)
        for each in self.peers:
            assert each.vardis.set_parameter("VARDISPAR_MAX_PAYLOAD_SIZE", ROOM_FOR_ALL) is None

    def inactive_for_a_while(self, which: int, rounds: int) -> None:
        peer = self.peer(which)
        peer.vardis.deactivate()
        for _ in range(rounds):
            self.round()
        peer.vardis.activate()

    # -- in the end all is well ---------------------------------------------------------------------------------

    @rule()
    def heal(self) -> None:
        self.blocked = set()
        self.delayed = []
        # Three summaries, and at least one creation and one update, go into each payload, a request is answered in
        # the next but one, and each instruction takes up to four payloads before others get their turn.
        rounds = 12 + 12 * len(self.owners)
        for _ in range(rounds):
            self.round()
            if not (outdated := self.outdated()):
                return
        raise AssertionError(f"after {rounds} rounds: {outdated}")

    def outdated(self) -> list:
        """Each node without the producer's value, with the variable."""
        found = []
        for var_id in self.own_alive():
            wanted = self.owners[var_id].entry(var_id)
            if var_id in self.tainted:
                continue
            for peer in self.peers:
                entry = peer.entry(var_id)
                if entry is not None and entry.is_deleted and wanted.spec.timeout:
                    continue
                if entry is None or entry.is_deleted or (entry.seqno, entry.value) != (wanted.seqno, wanted.value):
                    found.append((peer.index, var_id, entry, wanted))
        return found

    def round(self) -> None:
        """Every node sends a beacon that all others hear."""
        for sender in self.peers:
            self.now += PERIOD // len(self.peers)
            payload = sender.beacon(self.now)
            for peer in self.peers:
                if payload is not None and peer is not sender and (sender.index, peer.index) not in self.blocked:
                    self.deliver(peer, payload)

    # -- always -------------------------------------------------------------------------------------------------

    @invariant()
    def states_are_consistent(self) -> None:
        for peer in getattr(self, "peers", []):
            peer.vardis.check_invariants()
            # Where every octet comes from correct nodes, nothing is dropped for what it says.
            assert {effect.reason for effect in peer.effects if isinstance(effect, Dropped)}.isdisjoint(
                {"bad-value", "bad-description", "bad-repcnt", "id-mismatch", "update-bad-value", "database-full"}
            )

    @invariant()
    def no_node_is_ahead_of_the_producer(self) -> None:
        for peer in getattr(self, "peers", []):
            for found in peer.vardis.describe_database().variables:
                entry = peer.entry(found.spec.var_id)
                creations = [found.spec.creation_time]
                if found.spec.var_id in self.tainted:
                    creations = [time for var_id, time in self.history if var_id == found.spec.var_id]
                histories = [self.history[found.spec.var_id, time] for time in creations]
                assert any(entry.value in values[entry.seqno : entry.seqno + 1] for values in histories)

    @invariant()
    def changes_are_notified(self) -> None:
        for peer in getattr(self, "peers", []):
            told = {effect.var_id: effect for effect in peer.effects if isinstance(effect, VariableChanged)}
            for found in peer.vardis.describe_database().variables:
                entry, last = peer.entry(found.spec.var_id), told[found.spec.var_id]
                assert (last.value, last.event == "deleted") == (entry.value, entry.is_deleted)

    # -- helpers ------------------------------------------------------------------------------------------------

    def peer(self, which: int) -> Peer:
        return self.peers[which % len(self.peers)]

    def deliver(self, peer: Peer, payload: bytes) -> None:
        peer.vardis.handle_payload(payload, now=self.now, wall=peer.wall(self.now))

    def own_alive(self) -> list[int]:
        return [
            var_id
            for var_id, owner in self.owners.items()
            if var_id not in self.orphans and (entry := owner.entry(var_id)) is not None and not entry.is_deleted
        ]

    def is_known_elsewhere(self, var_id: int, owner: Peer) -> bool:
        """Whether another node has a variable, or instructions about it may be under way."""
        others = [peer for peer in self.peers if peer is not owner]
        return any(peer.entry(var_id) for peer in others) or bool(self.delayed) or owner.bp.slot is not None

    def value(self) -> bytes:
        """Another value each time, of another length most times."""
        self.values = getattr(self, "values", 0) + 1
        return self.values.to_bytes(4, "big") + bytes(self.values % 17)


class Network13(Network):
    """The same with 1.3: deleted variables leave the database, nothing times out."""

    version = "1.3"


TestNetwork = Network.TestCase
TestNetwork13 = Network13.TestCase
TestNetwork.settings = settings(max_examples=examples(40), stateful_step_count=40, deadline=None)
TestNetwork13.settings = settings(max_examples=examples(25), stateful_step_count=40, deadline=None)
