"""dcp-vardis.md: reactions of nodes to received records, and the links between nodes.

:mod:`dcp_conformance.check.reception` infers both from all reactions together; these rules report the results.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import ClassVar

from dcp_spec.constants import ICType

from dcp_conformance.check.base import Context, Invariant, Seen, name
from dcp_conformance.check.reception import Kind, Proved, Shortage, reception_of
from dcp_conformance.check.reception.following import Station
from dcp_conformance.check.reception.links import ALONE, summary
from dcp_conformance.check.statements import Statement
from dcp_conformance.definitions.verdict import Verdict

__all__ = ["RULES", "Counter"]

#: Minimum of the lower bound of the share that proves a link, beside ``ALONE`` reactions to the speaker alone.
_SHARE = 0.1
#: The absence of a link is proved by at least ``_TRIALS`` trials with a share of at most ``_SOME``.
_SOME, _TRIALS = 0.02, 20
#: Number of records without a reaction that a finding cites.
_CITED = 3
#: From ``_OCCASIONS`` occasions on, at least the share ``_MISSED`` must be missed for a verdict. With fewer occasions,
#: but at least ``_FEWEST``, all of them must be missed.
_OCCASIONS, _MISSED, _FEWEST = 5, 0.8, 4


class Counter:
    """Numbers of occasions and of missed ones, with the causes of the first three that were missed."""

    def __init__(self) -> None:
        self.occasions = self.missed = 0
        self.examples: list[Statement] = []

    def note(self, cause: Statement, *, missed: bool) -> None:
        """Count an occasion; ``cause`` is the record that gave it."""
        self.occasions += 1
        if missed:
            self.missed += 1
            if len(self.examples) < 3:
                self.examples.append(cause)

    @property
    def convincing(self) -> bool:
        """Whether the node missed so many occasions that a single lost frame does not explain it."""
        if self.occasions < _OCCASIONS:
            return self.missed == self.occasions >= _FEWEST
        return self.missed >= _MISSED * self.occasions


class ReceptionLinks(Invariant):
    """Report the links between nodes. This rule passes the beacons to the object that the other rules use, too."""

    id = "CK_NET_HEARS"
    section = "dcp-architecture.md: UWB"
    purpose = "Beacons reach neighbouring nodes: the reactions show which node hears which"
    requirements = ("UWB-01",)
    expect = "reactions of other nodes to the records of a beacon"
    enough = 1
    of_reactions = True

    def __init__(self, context: Context) -> None:
        super().__init__(context)
        self._reception = reception_of(context)

    def feed(self, seen: Seen) -> None:
        """Process the beacon for all rules of this module."""
        self._reception.feed(seen)

    def finish(self) -> None:
        """Report for each node the nodes that it hears, and those for which there is too little evidence."""
        self._reception.finish()
        nodes = [each for each in self._reception.observer.stations.values() if each.listens]
        found = summary(self._reception.links)
        for listener in nodes:
            shown, unknown = [], []
            for speaker in nodes:
                link = found.get((listener.node, speaker.node))
                if listener is speaker:
                    continue
                heard = link is not None and link.alone >= ALONE and link.at_least >= _SHARE
                if link is None or (not heard and (link.share > _SOME or link.trials < _TRIALS)):
                    unknown.append(name(speaker.node))
                elif heard:
                    self.exercised()
                    until = "" if link.lasts else f", not after {(link.end - self._reception.begin) / 1e9:.0f} s"
                    shown.append(f"{name(speaker.node)} ({link.share:.0%}, {link.reactions:.0f} reactions{until})")
            told = [name(each.node) for each in nodes if self.context.hears(listener.node, each.node)]
            if told:
                unknown = [each for each in unknown if each in told]
            text = f"{name(listener.node)} hears {', '.join(shown) or 'no node for certain'}"
            if unknown:
                text += f"; too little evidence for {', '.join(unknown)}"
            if told:
                text += f"; told: {', '.join(told)}"
            self.violated(text, [], expected="links between nodes, as reactions show", verdict=Verdict.INFO)


class _Reaction(Invariant):
    """Base of rules for one kind of reaction. :class:`ReceptionLinks` processes the beacons for them."""

    enough = 5
    of_reactions = True
    kinds: ClassVar[tuple[Kind, ...]]
    """The kinds of reaction that the rule judges."""
    by_cause: ClassVar[dict[ICType, str]] = {}
    """Kind of record -> the requirement of the reaction to it, if these differ."""
    limited: ClassVar[bool] = False
    """Whether a node may ignore records that exceed its limits."""

    def finish(self) -> None:
        """Count the reactions, and report the missing ones."""
        reception = reception_of(self.context)
        reception.finish()
        for shown in reception.shown.values():
            for kind in self.kinds:
                self._of_all += shown.hits.get(kind, 0)
        certain = set()
        for each in reception.shortages():
            if each.kind in self.kinds:
                self._report_missing(each)
                if each.certain:
                    certain |= {(each.station.node, each.var_id), each.station.node if each.var_id is None else None}
        for proved in reception.proved():
            node = proved.station.node
            if proved.kind in self.kinds and node not in certain and (node, proved.var_id) not in certain:
                self._report_proved(proved)

    def _report_missing(self, each: Shortage) -> None:
        """Report missing reactions; verdict info if they may exceed the node's limits, inconclusive if uncertain."""
        tally = each.tally
        what = "any variable" if each.var_id is None else f"variable {each.var_id}"
        text = (
            f"{name(each.station.node)}, {what}: {tally.all_hits} reactions to {tally.all_trials} occasions"
            f"{self._speakers(each)}"
        )
        rules = self._rules_of(tally.examples)
        limit = self._limit(each.station, tally.examples)
        if not each.certain:
            text += ", which unstable links could explain"
            self.violated(text, tally.examples, *rules, verdict=Verdict.INCONCLUSIVE)
        elif limit:
            text += f"; {limit}, which a node may ignore"
            self.violated(text, tally.examples, *rules, verdict=Verdict.INFO, expected=f"{self.expect}, within limits")
        else:
            if reason := self._reason(each):
                text += f"; the likely reason: {reason}"
            self.exercised(*rules, times=tally.all_trials)
            self.violated(text, tally.examples, *rules)

    def _report_proved(self, each: Proved) -> None:
        """Report missing reactions to records that the node has certainly received."""
        causes = [cause for cause, _ in each.examples[:_CITED]]
        cause, proof = each.examples[0]
        times = "" if each.times == 1 else f" {each.times} times, first"
        only = str(proof.frames[0]) if len(proof.frames) == 1 else "one of " + ", ".join(map(str, proof.frames))
        reaction = proof.reaction
        text = (
            f"{name(each.station.node)}, variable {each.var_id}: no reaction{times} to {cause.kind.label} of frame "
            f"{cause.frame}; it has received frame {only}: its {reaction.kind.label} of variable {reaction.var_id} in "
            f"frame {reaction.frame} has no other reason"
        )
        if limit := self._limit(each.station, causes):
            text += f"; {limit}, which a node may ignore"
            self.violated(text, causes, verdict=Verdict.INFO, expected=f"{self.expect}, within limits")
            return
        self.exercised(times=each.times)
        self.violated(text, [reaction, *causes], *self._rules_of(causes))

    def _rules_of(self, causes: Sequence[Statement]) -> tuple[str, ...]:
        """Return the requirements of the reactions to these records."""
        rules = dict.fromkeys(self.by_cause.get(each.kind, self.requirements[0]) for each in causes)
        return tuple(rules) if rules and self.by_cause else self.requirements

    def _speakers(self, each: Shortage) -> str:
        """Return the clause that names the speakers to whose other records the node reacts; empty if there are none."""
        if not each.speakers:
            return ""
        who = ", ".join(name(node) for node in each.speakers)
        return f", while it reacts to other records of {who}"

    def _reason(self, each: Shortage) -> str:
        """Return a property that all missed records share and no processed record has; empty if there is none."""
        shown = reception_of(self.context).shown[each.station.node]
        if each.tally.late_half and not shown.late_half:
            return "it reads only the first half of a payload"
        if each.tally.shortest > shown.longest > 0:
            return (
                f"it does not process payloads of {each.tally.shortest} or more octets "
                f"(the longest one that it reacts to has {shown.longest})"
            )
        return ""

    def _limit(self, station: Station, causes: Sequence[Statement]) -> str:
        """Return how the missed records exceed everything that the node has sent; otherwise empty."""
        above = ""
        for cause in causes if self.limited else ():
            above = ""
            if cause.kind is ICType.CREATE_VARIABLES:
                spec = cause.record.spec
                if spec.rep_cnt > max(station.repetitions, 1):
                    above = f"repCnt {spec.rep_cnt} is above the largest that it has stored ({station.repetitions})"
                elif len(spec.descr) > max(station.description, 1):
                    above = f"a description of {len(spec.descr)} octets is longer than all that it has stored"
                elif not spec.descr:
                    above = "the description is empty"
                value = cause.record.upd.value
            else:
                value = cause.record.value
            if not above and len(value) > max(station.value, 1):
                above = f"a value of {len(value)} octets is longer than all that it has stored ({station.value})"
            if not above:
                return ""
        return above


class TakesCreations(_Reaction):
    """A node stores a variable after receiving its create."""

    id = "CK_VD_TAKES_CREATE"
    section = "dcp-vardis.md: Processing CREATE-VARIABLES"
    purpose = "A node that hears the create of an unknown variable stores the variable"
    requirements = ("VD-PC-07", "VD-PC-09", "VD-RX-04")
    expect = "the variable in creates, summaries or updates of a node that hears its create"
    kinds = (Kind.TAKE_CREATE,)
    limited = True


class TakesUpdates(_Reaction):
    """A node stores the value of a newer update."""

    id = "CK_VD_TAKES_UPDATE"
    section = "dcp-vardis.md: Processing UPDATES"
    purpose = "A node that hears a newer value of a variable stores it"
    requirements = ("VD-PU-07", "VD-RX-04")
    expect = "the newer number in the summaries and updates of a node that hears the update"
    kinds = (Kind.TAKE_UPDATE,)
    limited = True


class TakesDeletions(_Reaction):
    """A node deletes a variable after receiving its delete."""

    id = "CK_VD_TAKES_DELETE"
    section = "dcp-vardis.md: Processing DELETE-VARIABLES"
    purpose = "A node that hears the delete of another node's variable deletes the variable and forwards the delete"
    requirements = ("VD-PD-04",)
    expect = "a delete, and no summary, from a node that hears a delete"
    kinds = (Kind.TAKE_DELETE,)


class AnswersUpdateRequests(_Reaction):
    """A node answers requests for updates."""

    id = "CK_VD_ANSWER_UPDATE"
    section = "dcp-vardis.md: Processing REQUEST-VARUPDATES"
    purpose = "A node that has a newer value and hears a request for it sends it"
    requirements = ("VD-RU-04",)
    expect = "an update after a request that tells an older number"
    kinds = (Kind.ANSWER_UPDATE,)


class AnswersCreateRequests(_Reaction):
    """A node answers requests for creates."""

    id = "CK_VD_ANSWER_CREATE"
    section = "dcp-vardis.md: Processing REQUEST-VARCREATES"
    purpose = "A node that has a variable and hears a request for it sends its create"
    requirements = ("VD-RC-03",)
    expect = "a create after a request"
    kinds = (Kind.ANSWER_CREATE,)


class AsksForUpdates(_Reaction):
    """A node requests the value after a summary with a newer number."""

    id = "CK_VD_ASK_UPDATE"
    section = "dcp-vardis.md: Processing SUMMARIES"
    purpose = "A node that hears a summary with a newer number asks for the value"
    requirements = ("VD-PS-04",)
    expect = "a request with the node's own number after a summary with a newer one"
    kinds = (Kind.ASK_UPDATE,)


class AsksForCreations(_Reaction):
    """A node requests the create of an unknown variable."""

    id = "CK_VD_ASK_CREATE"
    section = "dcp-vardis.md: Processing SUMMARIES"
    purpose = "A node that hears a record of an unknown variable asks for its create"
    requirements = ("VD-PS-01", "VD-PU-01", "VD-RC-01", "VD-RU-01")
    expect = "a request after the first summary, update or request of an unknown variable"
    kinds = (Kind.ASK_CREATE,)
    by_cause: ClassVar[dict[ICType, str]] = {
        ICType.UPDATES: "VD-PU-01",
        ICType.SUMMARIES: "VD-PS-01",
        ICType.REQUEST_VARCREATES: "VD-RC-01",
        ICType.REQUEST_VARUPDATES: "VD-RU-01",
    }


class AnswersOlderNumber(_Reaction):
    """A node sends its value after hearing an older number."""

    id = "CK_VD_TEACH"
    section = "dcp-vardis.md: Processing SUMMARIES"
    purpose = "A node that hears an older number of another node's variable sends its newer value"
    requirements = ("VD-PS-03", "VD-PU-06")
    expect = "an update after a summary or update with an older number"
    kinds = (Kind.TEACH,)
    by_cause: ClassVar[dict[ICType, str]] = {ICType.UPDATES: "VD-PU-06", ICType.SUMMARIES: "VD-PS-03"}


RULES: tuple[type[Invariant], ...] = (
    ReceptionLinks,
    TakesCreations,
    TakesUpdates,
    TakesDeletions,
    AsksForUpdates,
    AsksForCreations,
    AnswersUpdateRequests,
    AnswersCreateRequests,
    AnswersOlderNumber,
)
