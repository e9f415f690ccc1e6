"""Generate sequences for pairs that were not reached yet: a kind of message for a variable in a certain state."""

from __future__ import annotations

from collections import Counter
from typing import Final

from dcp_spec.constants import seqno_modulus

from dcp_codec.codec import Codec
from dcp_codec.testing.mutation import Touch
from dcp_codec.values import VarDelete, VardisRecord, VarReqCreate, VarReqUpdate, VarSumm, VarUpdate
from dcp_conformance.fuzz.steps import Call, Step, Wait

from .elements import CREATION
from .sequences import Sequences

#: Probability of a directed sequence while pairs are missing.
_CHANCE: Final = 0.25
#: Sequence number of a variable of another producer; that of a variable of the node starts at 0.
_NUMBER: Final = 5
_NUMBERED: Final = ("update", "summary", "request-update")


def possible_states(codec: Codec) -> frozenset[Touch]:
    """Return the pairs of state and message of a profile, under the names that ``Observer`` gives them."""
    has_times = "creationTime" in codec.profile.vardis.var_spec
    found = {("unknown", name) for name in ("delete", "request-create", "create", *_NUMBERED)}
    for state in ("alive own", "alive foreign", "deleted own", "deleted foreign"):
        found |= {(state, "delete"), (state, "request-create")}
        found |= {(state, f"{name} {how}") for name in _NUMBERED for how in ("equal", "newer", "older", "opposite")}
        if not has_times:
            found.add((state, "create"))
            continue
        # The exact creation time of a variable of the node is unknown to the generator.
        hows = ("earlier", "later") if state.endswith("own") else ("earlier", "equal", "later")
        found |= {(state, f"create {how}") for how in hows}
    return frozenset(found)


class Directed:
    """Generator of sequences, some of them for pairs that are missing in ``reached``."""

    def __init__(self, sequences: Sequences, reached: Counter[Touch]) -> None:
        """``reached``: number of times that each pair was reached; the caller updates it."""
        self._sequences = sequences
        self._reached = reached
        self._possible = sorted(possible_states(sequences.codec))
        stamp = sequences.codec.profile.types.timestamp
        self._latest = (1 << (8 * stamp.width - stamp.signed)) - 1
        self._half = seqno_modulus(sequences.codec.profile.types.var_seqno.width) // 2
        self.kinds: tuple[str, ...] = ()

    def draw(self) -> list[Step]:
        """Return the next sequence."""
        sequences = self._sequences
        if sequences.rng.random() < _CHANCE:
            missing = [pair for pair in self._possible if not self._reached[pair]]
            if missing:
                self.kinds = ("directed",)
                return self.towards(*sequences.rng.choice(missing))
        steps = sequences.draw()
        self.kinds = sequences.kinds
        return steps

    def keep(self, steps: list[Step]) -> None:
        """See :meth:`Sequences.keep`."""
        self._sequences.keep(steps)

    def towards(self, state: str, message: str) -> list[Step]:
        """Return a sequence that brings a variable into a state and sends a message about it."""
        sequences, var_id = self._sequences, self._sequences.var_id()
        life, _, whose = state.partition(" ")
        found: list[Step] = []
        number = 0
        if whose == "own":
            params = {"varId": var_id, "repCnt": 1, "descr": "own", "value": "00"}
            found = [Call("RTDB-Create", params), Wait(1.0)]
            if life == "deleted":
                # Up to 1.3 the variable is forgotten after its last VarDelete, which may be in the next beacon.
                found += [Call("RTDB-Delete", {"varId": var_id}), Wait(0.1)]
        elif whose == "foreign":
            number = _NUMBER
            found = [sequences.frame(sequences.good_create(var_id, seqno=number, creation=CREATION))]
            if life == "deleted":
                found.append(sequences.frame(VarDelete(var_id)))
        # The sender is allowed to send this message.
        return [*found, sequences.frame(self._record(message, var_id, number))]

    def _record(self, message: str, var_id: int, number: int) -> VardisRecord:
        name, _, how = message.partition(" ")
        numbers = {"newer": number + 1, "older": number - 1, "opposite": number + self._half}
        seqno = numbers.get(how, number) % (2 * self._half)
        match name:
            case "delete":
                return VarDelete(var_id)
            case "request-create":
                return VarReqCreate(var_id)
            case "update":
                return VarUpdate(var_id, seqno, b"x")
            case "summary":
                return VarSumm(var_id, seqno)
            case "request-update":
                return VarReqUpdate(var_id, seqno)
        time = {"earlier": CREATION - 1, "later": self._latest - 1}.get(how, CREATION)
        return self._sequences.good_create(var_id, seqno=number, creation=time)
