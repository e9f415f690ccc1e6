"""Judge the recordings of a cell: the rules of ``check`` for all transmitted frames, and stations that died."""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterator, Sequence

from dcp_conformance.check.judge import Judge
from dcp_conformance.definitions.declared import declared_by
from dcp_conformance.definitions.pics import Pics, Testing
from dcp_conformance.definitions.results import Check
from dcp_conformance.definitions.verdict import Verdict

from dcp_codec.capture.frame import Frame
from dcp_codec.codec import Codec

from .world import Place, Received, Sent, World, node_text


def ether_frame(codec: Codec, source: bytes, octets: bytes) -> bytes:
    """An Ethernet frame with a bearer payload."""
    number = codec.profile.link.ether_type or 0x4953
    return b"\xff" * 6 + source + number.to_bytes(2, "big") + octets


def frames_of(world: World, transmissions: Sequence[Sent | Received]) -> list[Frame]:
    """Transmissions or receptions as the frames of a recording, numbered from 1."""
    found = []
    for number, each in enumerate(transmissions, 1):
        sender = each.sender if isinstance(each, Received) else each.place
        tester = sender >= len(world.places)
        place = world.places[0 if tester else sender]
        source = world.tester_address if tester else address_of(place)
        data = ether_frame(place.codec, source, each.octets)
        found.append(Frame(number, world.epoch + each.time, data, len(data)))
    return found


def address_of(place: Place) -> bytes:
    """The address of the interface of a place."""
    return b"\x02" + (place.number + 1).to_bytes(5, "big")


def deaths(world: World, requirements: tuple[str, ...]) -> Iterator[Check]:
    """Yield a failed check for each implementation that ended by itself."""
    for place, how in sorted(world.deaths().items()):
        name = world.places[place].implementation
        yield Check(
            Verdict.FAIL, requirements, "every implementation lives to the end", f"place {place} ({name}): {how}"
        )


def rules(
    world: World, sent: Sequence[Sent], *, strangers: Collection[bytes] = (), restarts: Sequence[tuple[int, int]] = ()
) -> Iterator[Check]:
    """Yield the failed rules of ``check`` on everything that the places transmitted, for each version in use.

    Findings that concern only frames of the tester's own station, or one of the ``strangers`` that it plays
    (node identifiers), are left out, and so are requirements that the common profile declares as not met: a layout that
    all stations share harms none of them, and the report lists it for each implementation.
    ``restarts``: times (ns) and places that were switched on again.
    """
    played = [node_text(each) for each in strangers]
    profiles: dict[str, Codec] = {}
    for place in world.places:
        profiles.setdefault(place.codec.profile.name, place.codec)
    for name, codec in profiles.items():
        own = {place.number for place in world.places if place.codec.profile.name == name}
        every = {place.number for place in world.places}
        wanted = [each for each in sent if each.place in own or each.place not in every]
        periods = {place.limits.beacon_period_ms for place in world.places}
        # With several periods in a network no single one decides whether a station keeps to its own.
        known = len(periods) == 1 and world.patience == 1
        pics = Pics(pixit=Testing(beacon_period_ms=max(periods)))
        judge = Judge(codec, pics, recording="all links", period_known=known)
        declared = declared_by(codec.profile)
        awaited = deque(sorted(restarts))
        for transmission, frame in zip(wanted, frames_of(world, wanted), strict=True):
            while awaited and awaited[0][0] <= transmission.time:
                judge.restarted(world.places[awaited.popleft()[1]].node_id)
            judge.feed(frame)
        for case in judge.result().cases:
            if case.verdict is not Verdict.FAIL:
                continue
            for check in case.checks:
                cited = [wanted[mark.frame - 1].place for mark in check.frames if 0 < mark.frame <= len(wanted)]
                if check.verdict is not Verdict.FAIL or (cited and not any(each in every for each in cited)):
                    continue
                if set(check.requirements) <= declared.keys():
                    continue
                if not cited and any(text in check.observed for text in played):
                    continue
                # A finding that begins with a node concerns it; its frames can be those that the node did not react to.
                accused = [
                    place.number for place in world.places if check.observed.startswith(node_text(place.node_id))
                ]
                places = accused or sorted(set(cited) & every)
                who = ", ".join(f"place {n} ({world.places[n].implementation})" for n in places)
                yield Check(
                    Verdict.FAIL, check.requirements, f"{case.id}: {check.expected}",
                    f"{who + ': ' if who else ''}{check.observed}", check.frames, seconds=check.seconds,
                )  # fmt: skip
