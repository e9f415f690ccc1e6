"""Stimuli that VarDis must answer, and variables that the implementation must learn."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass
from typing import Final, NoReturn, Unpack

from dcp_spec.constants import ICType

from dcp_codec.values import VarCreate
from dcp_conformance.frames.builder import FrameBuilder
from dcp_conformance.frames.received import ReceivedBeacon

from .identifiers.allocation import Identifiers
from .judgement.matchers import Matchers
from .judgement.verdicts import Verdicts
from .known import Question, RunFindings
from .reception.receiver import Receiver
from .reception.waiting import Waiting
from .sending.peers import Peer, Peers
from .sending.records import CreationFields, Records
from .sut_properties import SutProperties

#: Maximum number of identifiers in a message.
_NAMES: Final = 8


@dataclass(eq=False)
class Probes:
    """Asks VarDis for a sign of life."""

    _run: RunFindings
    _peers: Peers
    _identifiers: Identifiers
    _waiting: Waiting
    _verdicts: Verdicts

    def probe(self, periods: float | None = None) -> bool:
        """Send a stimulus that VarDis must answer, and return whether it does.

        The stimulus is a summary of an unknown variable, unless the implementation did not answer summaries at the
        start of the run: then it is a kind that it answered. ``periods``: see :meth:`.Waiting.until`.
        """
        question, identifiers = self._run.known.question, self._identifiers
        used = len(identifiers.called_unknown)
        if question == "summary" and not identifiers.has_unknown_ids(1 + used):
            # The answer to a summary of, or a request for, a variable of the case would look like a reaction to what
            # the case did before.
            if (spare := identifiers.spare_var_id()) is not None:
                return self._creates(spare, periods)
            if identifiers.created and not identifiers.has_unknown_ids():
                # A full database requests no further variable (X43).
                question = "request"
        return self.ask(question, periods)

    def ask(self, kind: Question, periods: float | None = None) -> bool:
        """Send a stimulus of this kind to VarDis, and return whether the answer comes in time.

        ``summary`` of an unknown variable: a request for it (VD-PS-01). ``create`` of a variable: it is forwarded
        (VD-PC-09); a request for an older one is not an answer. ``request``: the VarCreate of a variable that the
        tester has created, or a request for an unknown one (VD-RC-01, VD-RC-03).
        """
        identifiers = self._identifiers
        if kind == "create":
            return self._creates(identifiers.var_id(), periods)
        peer = self._peers.new()
        if kind == "summary":
            var_id = identifiers.unknown_id()
            peer.send(peer.summary(var_id, 1))
            return self._waiting.until_instruction(ICType.REQUEST_VARCREATES, var_id, periods) is not None
        unknown = identifiers.unknown_ids(1) if identifiers.has_unknown_ids() else ()
        wanted = [*sorted(identifiers.created)[:1], *unknown]
        peer.send(*map(peer.request_create, wanted))

        def answered(heard: ReceivedBeacon) -> bool:
            return self._forwards(heard) or any(heard.about(ICType.REQUEST_VARCREATES, each) for each in wanted)

        return bool(wanted) and self._waiting.until(answered, periods) is not None

    def _creates(self, var_id: int, periods: float | None) -> bool:
        """Send a VarCreate, and return whether the implementation forwards it in time."""
        peer = self._peers.new()
        peer.send(peer.create(var_id))
        return self._waiting.until_instruction(ICType.CREATE_VARIABLES, var_id, periods) is not None

    def _forwards(self, heard: ReceivedBeacon) -> bool:
        """Return whether a beacon has a VarCreate of one of the case's peers."""
        ours = [peer.node_id for peer in self._peers.made]
        return any(each.record.spec.prod_id in ours for each in heard.instructions(ICType.CREATE_VARIABLES))

    def require_alive(self, after: str, *requirements: str) -> None:
        """Fail and stop the case unless VarDis still answers."""
        alive, what = self.probe() or self.probe(), f"VarDis still answers after {after}"
        Matchers(self._verdicts).required(alive, what, *requirements, seen="no answer to two probes")

    def require_processed(self, after: str, *requirements: str) -> None:
        """As :meth:`require_alive`; then wait for one more beacon, which shows what ``after`` has caused."""
        self.require_alive(after, *requirements)
        self._waiting.beacons(1, 1.5)


@dataclass(eq=False)
class Teaching:
    """Teaches the implementation variables that a case needs."""

    _builder: FrameBuilder
    _records: Records
    _sut: SutProperties
    _receiver: Receiver
    _waiting: Waiting
    _verdicts: Verdicts

    def learn(self, peer: Peer, *creates: VarCreate) -> None:
        """Teach the implementation variables, and wait for the last repetition of their VarCreates.

        Stops as inconclusive if it does not forward one of them.
        """
        start = self._waiting.mark()
        wanted = {create.spec.var_id for create in creates}
        peer.send_all(creates)

        def present(heard: ReceivedBeacon) -> bool:
            return any(each.var_id in wanted for each in heard.instructions(ICType.CREATE_VARIABLES))

        def forwarded() -> Counter[int]:
            return Counter(each.var_id for each in self._receiver.instructions(ICType.CREATE_VARIABLES, since=start))

        def complete() -> bool:
            seen = forwarded()
            return all(seen[create.spec.var_id] >= create.spec.rep_cnt for create in creates)

        self._waiting.until_quiet(present, since=start, complete=complete)
        if missing := wanted - set(forwarded()):
            self.not_learnt(missing)

    def learnt(self, peer: Peer, var_id: int, **record: Unpack[CreationFields]) -> VarCreate:
        """Teach the implementation a variable, as :meth:`learn` does, and return its VarCreate."""
        create = peer.create(var_id, **record)
        self.learn(peer, create)
        return create

    def not_learnt(self, missing: Collection[int]) -> NoReturn:
        """Stop the case as inconclusive: it needs variables that the implementation has not learnt."""
        # Their payloads were as large as the implementation's maximum.
        self._sut.bound("VARDISPAR_MAX_PAYLOAD_SIZE")
        names = ", ".join(map(str, sorted(missing)[:_NAMES]))
        more = f" and {len(missing) - _NAMES} more" if len(missing) > _NAMES else ""
        self._verdicts.inconclusive(
            "forwarded VarCreates of all variables, which this case needs", f"none of {names}{more}"
        )

    def periods(self, count: int) -> float:
        """Return the maximum number of beacon periods until the implementation has forwarded ``count`` VarCreates.

        They have the usual length. As :attr:`.SutProperties.reaction`, and longer if they need several payloads.
        """
        room = self._sut.parameter("VARDISPAR_MAX_PAYLOAD_SIZE") - self._builder.container_header_size
        each = max(1, room // self._builder.record_size(self._records.sample()))
        return self._sut.reaction + math.ceil(count / each) - 1
