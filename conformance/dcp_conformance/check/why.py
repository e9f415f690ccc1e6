"""Why a node holds the value of a variable that it holds: the frames that brought it, and where newer ones stopped."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec

from dcp_codec.analysis.chain import Hears, ahead, at, came, count, way
from dcp_codec.analysis.entry import DELETED, UNKNOWN, Entry
from dcp_conformance.errors import UsageError

from .base import name
from .judge import Judge

#: Number of proofs of reception that are listed for one node.
_PROOFS = 3


class Step(msgspec.Struct, frozen=True, omit_defaults=True):
    """One line of an answer."""

    text: str
    seconds: float | None = None
    """Time since the first frame; None if the line is not about a moment."""
    frame: int = 0
    """Number of the frame that shows it; 0 for none."""
    node: str = ""


class Answer(msgspec.Struct, frozen=True):
    """The answer: what the node holds, how it came, and what has stopped newer values."""

    holds: Step
    came: tuple[Step, ...]
    stopped: tuple[Step, ...]
    links: str
    """The origin of the links."""


def why(judge: Judge, variable: int, node: str, seconds: float | None) -> Answer:
    """Answer for a variable and a node (the end of its identifier is enough) at a time since the first frame.

    ``judge`` has processed the recording. ``seconds``: None for the end. Raises :class:`UsageError`.
    """
    ledger = judge.ledger
    entries = ledger.entries(variable)
    nodes = ledger.nodes
    fitting = [each for each in nodes if name(each).endswith(node.lower())]
    if len(fitting) != 1:
        listed = ", ".join(name(each) for each in (fitting or nodes)[:12])
        raise UsageError(f"--node {node}: {'fits several nodes' if fitting else 'is not in the recording'}: {listed}")
    if not entries:
        known = sorted({each.var_id for each in ledger.entries()})
        raise UsageError(f"--variable {variable}: no record about it; there are {', '.join(map(str, known[:20]))}")
    return _Question(judge, entries, variable, fitting[0], seconds).answer()


class _Question:
    def __init__(
        self, judge: Judge, entries: Sequence[Entry], variable: int, node: bytes, seconds: float | None
    ) -> None:
        self._judge, self._entries, self._variable, self._node = judge, entries, variable, node
        self._begin = judge.ledger.begin or 0
        self._time = judge.ledger.end if seconds is None else self._begin + round(seconds * 1e9)
        self._producer = judge.ledger.producers.get(variable)
        self._own = [each for each in entries if each.node == self._producer and each.time <= self._time]
        self._hears: Hears = judge.hears

    def answer(self) -> Answer:
        """Return the answer."""
        held = at(self._entries, self._node, self._time)
        hops = () if held is None or held.number < 0 else self._came(held)
        return Answer(self._holds(held), hops, tuple(self._stopped(held)), self._judge.links_origin)

    def _step(self, text: str, time: int | None = None, frame: int = 0, node: bytes = b"") -> Step:
        seconds = None if time is None else round((time - self._begin) / 1e9, 3)
        return Step(text, seconds, frame, name(node) if node else "")

    def _state(self, entry: Entry | None) -> str:
        """Describe a state."""
        if entry is None:
            return f"has sent no record about variable {self._variable}"
        if entry.number == DELETED:
            return f"has deleted variable {self._variable}"
        if entry.number == UNKNOWN:
            return f"does not have variable {self._variable}, and has requested it {entry.asked} times"
        return f"holds {entry.number} of variable {self._variable}"

    def _holds(self, held: Entry | None) -> Step:
        text = self._state(held)
        if self._node == self._producer:
            text += ", as its producer"
        elif self._own:
            newest = next((each for each in reversed(self._own) if each.number >= 0), self._own[-1])
            producer = f"its producer {name(newest.node)}"
            missed = 0
            if held is not None and held.number >= 0:
                place = max((i for i, each in enumerate(self._own) if each.number == held.number), default=None)
                missed = 0 if place is None else sum(each.number >= 0 for each in self._own[place + 1 :])
            if self._own[-1].number == DELETED:
                text += f"; {producer} has deleted it"
            elif held is not None and held.number == newest.number:
                text += f", as {producer} does"
            else:
                text += f"; {producer} has {newest.number}" + (
                    f", {missed} number{'' if missed == 1 else 's'} later" if missed else ""
                )
            if held is not None and held.left is not None and held.left.time <= self._time:
                text += f", and left this state {(self._time - held.left.time) / 1e9:.1f} s before"
        if held is None:
            return self._step(text, node=self._node)
        return self._step(text, held.time, held.frame, self._node)

    def _came(self, held: Entry) -> tuple[Step, ...]:
        """Return how the state came to the node."""
        steps = []
        for hop in came(held, self._entries, self._judge.ledger.producers, self._hears):
            entry, verb = hop.entry, hop.entry.kind.label
            if hop.source is not None and hop.frame is not None:
                frames = count(hop, self._entries, self._hears)
                only = "the only frame with it before" if frames == 1 else f"the last of {frames} frames with it"
                text = (
                    f"states {entry.number} in {verb}, after frame {hop.frame[0]} of {name(hop.source.node)} ({only})"
                )
            elif entry.node == self._producer:
                text = f"the producer states {entry.number} in {verb}"
            else:
                text = f"states {entry.number} in {verb}; no earlier frame that it can have heard has it"
            if entry.values:
                text += f"; it sends the value in frame {entry.carried[0][0]}"
                text += f" and {entry.values - 1} more" if entry.values > 1 else ""
            steps.append(self._step(text, entry.time, entry.frame, entry.node))
        return tuple(steps)

    def _stopped(self, held: Entry | None) -> list[Step]:
        """Return what each node on the way has done with newer values; empty if the node has the newest one."""
        if self._producer is None or not ahead(self._own[-1] if self._own else None, held, self._own):
            return []

        def newer(node: bytes) -> bool:
            return ahead(at(self._entries, node, self._time), held, self._own)

        since = self._begin if held is None else held.time
        nodes = way(self._node, self._judge.ledger.nodes, self._producer, self._hears, newer)
        steps = []
        before = b""
        for node in nodes:
            state = at(self._entries, node, self._time)
            text, frame, time = self._state(state), 0, None
            if state is not None:
                frame, time = state.frame, state.time
            sent = [
                stamp
                for each in self._entries
                if each.node == node and ahead(each, held, self._own)
                for stamp in each.carried
                if since <= stamp[1] <= self._time
            ]
            if sent:
                total = sum(each.values for each in self._entries if each.node == node and ahead(each, held, self._own))
                text += f"; it sends newer values in {total} frames, first {sent[0][0]}, last {max(sent)[0]}"
            if state is not None and state.asked and state.last_asked is not None:
                text += f"; it requests the update {state.asked} times up to frame {state.last_asked[0]}"
            if before and self._hears(node, before) is None:
                text += f"; that it hears {name(before)} is neither told nor proved (--hears)"
            steps.append(self._step(text, time, frame, node))
            steps += self._proofs(node, since)
            before = node
        if not nodes:
            steps.append(self._step("no links lead from the producer to this node"))
        return steps

    def _proofs(self, node: bytes, since: int) -> list[Step]:
        """Return the proofs that a node has received frames with newer values, or the delete, and not followed them."""
        steps = []
        for proved in self._judge.reception.proved(least=1):
            if proved.station.node != node or proved.var_id != self._variable:
                continue
            within = [each for each in proved.examples if since <= each[0].time <= self._time]
            for cause, proof in within[:_PROOFS]:
                frames = " or ".join(map(str, proof.frames))
                text = (
                    f"has received {cause.kind.label} {'' if cause.number < 0 else f'with {cause.number} '}"
                    f"in frame {frames}, and does not react; its {proof.reaction.kind.label} of variable "
                    f"{proof.reaction.var_id} proves the reception"
                )
                steps.append(self._step(text, proof.reaction.time, proof.reaction.frame, node))
            if len(within) > _PROOFS:
                steps.append(self._step(f"{len(within) - _PROOFS} more such frames", node=node))
        return steps
