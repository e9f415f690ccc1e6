"""The sweep at the beginning of a campaign: each kind of structural damage once, in the smallest frame that has it.

Random mutation takes long to produce an empty block or a container without records. The sweep tries each kind within
the first few hundred frames, with one anomaly in each frame, so that crashes have small and named causes from the
start. The kinds alternate, so that the many truncated records do not delay the other kinds.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from typing import Final

from dcp_spec.constants import BP_PROTID_SRP, BP_PROTID_VARDIS, IC_MAX_RECORDS, ICType

from dcp_codec.codec import Codec
from dcp_codec.errors import EncodeError
from dcp_codec.plan.tree import Scalar
from dcp_codec.values import Beacon, Container, Payload
from dcp_lab.fuzz.reduce.anatomy import Anatomy, Announced
from dcp_lab.fuzz.steps import Frame, Generator, Step, Wait
from dcp_lab.testing.mutation import generic

from .samples import OTHER_PROTOCOL, Samples
from .sequence_batches import Joined

#: Container types that no version of the specification defines.
_UNKNOWN: Final = (0, 7, 255)
#: Numbers of octets after a beacon: the padding of links, and more.
_TRAILING: Final = (1, 46, 400)
#: Number of neighbours, more than tables of 256 and of 1000 entries can hold.
_NEIGHBOURS: Final = 1100
#: Creations in one frame of a flood of variables, and number of unused variable identifiers for markers.
_SHARE: Final = 20
_LEFT: Final = 16
#: Name of the sequences of the sweep in statistics.
NAME: Final = "sweep"


class Sweep:
    """The frames of a sweep for a profile, in an order in which each kind of damage is early."""

    def __init__(self, codec: Codec) -> None:
        self.codec = codec
        self._samples = Samples(codec)
        self._each = self._samples.each()
        self._sound = self._each[0]

    def sequences(self) -> list[list[Step]]:
        """Return the sequences of the sweep; most have a single frame."""
        kinds = (
            self._emptiness, self._blocks, self._containers, self._announcements, self._lengths, self._header,
            self._cuts, self._extremes, self._unrelated_frames,
        )  # fmt: skip
        turns = itertools.zip_longest(*(list(kind()) for kind in kinds))
        frames = dict.fromkeys(each for turn in turns for each in turn if each is not None)
        found: list[list[Step]] = [[Frame(octets, b"", NAME)] for octets in frames]
        return [*found, *self._floods()]

    # -- kinds ---------------------------------------------------------------------------------------------------

    def _emptiness(self) -> Iterator[bytes]:
        """Yield an empty frame, a header without payload, and truncated headers."""
        yield b""
        anatomy = Anatomy(self.codec, self._sound)
        payloads = anatomy.at("payloads")
        if payloads is None or not payloads.children or not payloads.offset:
            return
        bare = anatomy.without([payloads.children[0]])
        yield bare
        # A header without payload, but with the length of one.
        yield self._sound[: payloads.offset]
        yield self._sound[:1]
        for field in anatomy.root.walk():
            if field.path.startswith("bp.") and field.offset:
                yield self._sound[: field.offset]
                yield self._sound[: field.offset + field.length - 1]

    def _blocks(self) -> Iterator[bytes]:
        """Yield empty and truncated blocks, alone and next to valid ones."""
        good = self._samples.vardis(self._samples.container(ICType.SUMMARIES))
        protocols = (int(BP_PROTID_VARDIS), int(BP_PROTID_SRP), OTHER_PROTOCOL)
        for protocol in protocols:
            empty = Payload(protocol, b"")
            yield from self._encoded([empty])
            yield from self._encoded([good, empty])
            yield from self._encoded([empty, good])
        for protocol in protocols:
            yield from self._encoded([Payload(protocol, b"\0")])
        whole = Anatomy(self.codec, self._sound)
        payloads = whole.at("payloads")
        if payloads is not None:
            start = payloads.offset
            for stop in range(start + 1, min(start + 4, len(self._sound))):
                yield self._fitting(self._sound[:stop])

    def _containers(self) -> Iterator[bytes]:
        """Yield containers without records, of unknown types, and with wrong counts; alone and next to a valid one."""
        good = self.codec.encode_containers((self._samples.container(ICType.SUMMARIES),))
        for kind in ICType:
            one = self.codec.encode_containers((self._samples.container(kind),))
            header = self._header_size(one)
            empty = one[: header - 1] + b"\0"
            yield from self._vardis(empty)
            yield from self._vardis(good + empty)
            yield from self._vardis(empty + good)
            yield from self._vardis(one[: header - 1] + b"\0" + one[header:])
        for number in _UNKNOWN:
            unknown = bytes((number,)) + good[1:]
            yield from self._vardis(unknown)
            yield from self._vardis(good + unknown)
            yield from self._vardis(unknown + good)

    def _announcements(self) -> Iterator[bytes]:
        """Yield frames with a length or a count of 0, one too low, one too high, or near its maximum."""
        for octets in self._each:
            anatomy = Anatomy(self.codec, octets)
            for announced in anatomy.announced:
                for value in self._wrong(announced):
                    yield anatomy.replaced(announced.field, value)

    def _lengths(self) -> Iterator[bytes]:
        """Yield payloads of fixed size that are too long or too short."""
        if self.codec.report_plan is None:
            return
        report = self._samples.report()
        anatomy = Anatomy(self.codec, self._samples.beacon(report))
        field = anatomy.at("payloads[0].srp")
        if field is not None:
            for size in (1, field.length - 1, field.length + 1, 2 * field.length):
                yield from self._encoded([Payload(BP_PROTID_SRP, (field.raw * 2)[:size])])

    def _header(self) -> Iterator[bytes]:
        """Yield frames with a header field set to 0, increased by one, or set to its maximum."""
        anatomy = Anatomy(self.codec, self._sound)
        for field in anatomy.root.walk():
            if isinstance(field.layout, Scalar) and field.path.startswith(("bp.", "payloads[0].protocolId")):
                value, size = int.from_bytes(field.raw, "big"), field.length
                for number in (0, value + 1, (1 << (8 * size)) - 1):
                    octets = (number % (1 << (8 * size))).to_bytes(size, "big")
                    if octets != field.raw:
                        yield self._sound[: field.offset] + octets + self._sound[field.offset + size :]

    def _cuts(self) -> Iterator[bytes]:
        """Yield payloads truncated in each field of each record, with correct lengths of beacon and block."""
        cuts: list[list[bytes]] = []
        for octets in self._each:
            anatomy = Anatomy(self.codec, octets)
            first = anatomy.at("payloads[0]")
            if first is None:
                continue
            places = {field.offset for field in anatomy.root.walk()} | {
                field.offset + field.length - 1 for field in anatomy.root.walk() if field.length > 1
            }
            content = first.offset + self._block_header(anatomy)
            inside = sorted((place for place in places if content < place < len(octets)), reverse=True)
            cuts.append([self._fitting(octets[:place]) for place in inside])
        for turn in itertools.zip_longest(*cuts):
            yield from (octets for octets in turn if octets is not None)

    def _extremes(self) -> Iterator[bytes]:
        """Yield many records, containers and blocks, and octets after a beacon."""
        samples = self._samples
        for kind in (ICType.SUMMARIES, ICType.REQUEST_VARCREATES, ICType.DELETE_VARIABLES, ICType.UPDATES):
            yield from self._encoded([samples.vardis(samples.container(kind, IC_MAX_RECORDS))])
        one = samples.container(ICType.SUMMARIES)
        yield from self._encoded([samples.vardis(*[one] * 200)])
        yield from self._encoded([samples.vardis(one)] * 100)
        yield from self._encoded([samples.other()] * 200)
        yield from self._encoded([samples.other(bytes(1200))])
        for count in _TRAILING:
            yield self._sound + bytes(count)
            yield self._sound + b"\xff" * count

    def _unrelated_frames(self) -> Iterator[bytes]:
        """Yield ordinary beacons of each kind, and frames of a repeated octet."""
        yield from self._each
        for octet in (0x00, 0xFF, 0x01):
            yield bytes((octet,)) * 40

    def _floods(self) -> list[list[Step]]:
        """Return sequences with nearly all variables, and with more neighbours than tables can hold."""
        samples, found = self._samples, list[list[Step]]()
        top = 1 << (8 * min(1, self.codec.profile.types.var_id.width))
        whole = samples.container(ICType.CREATE_VARIABLES, top - _LEFT)
        creations: list[Step] = []
        for first in range(0, len(whole.records), _SHARE):
            several = Container(whole.ic_type, whole.records[first : first + _SHARE])
            creations += [Frame(octets, octets, NAME) for octets in self._encoded([samples.vardis(several)])]
        found.append([*creations, Wait(2.0)])
        if self.codec.report_plan is not None:
            reports: list[Step] = []
            for number in range(1, _NEIGHBOURS + 1):
                octets = samples.beacon(samples.report(number), station=number)
                reports.append(Frame(octets, octets, NAME, samples.address(number)))
            found.append([*reports, Wait(2.0)])
        return found

    # -- building ------------------------------------------------------------------------------------------------

    def _encoded(self, blocks: list[Payload]) -> Iterator[bytes]:
        """Yield a beacon of these blocks, unless it exceeds the size of a frame or the range of a length field."""
        try:
            octets = self._envelope(blocks)
        except EncodeError:
            return
        if len(octets) <= max(1500, self.codec.profile.limits.max_beacon_size):
            yield octets

    def _envelope(self, blocks: list[Payload]) -> bytes:
        plain = [
            each if isinstance(each.content, bytes) else Payload(each.protocol_id, self._content(each))
            for each in blocks
        ]
        header = self.codec.decode(self._sound).bp
        return self.codec.encode_envelope(Beacon(header, tuple(plain)))

    def _content(self, block: Payload) -> bytes:
        if isinstance(block.content, tuple):
            return self.codec.encode_containers(block.content)
        assert not isinstance(block.content, bytes)
        return self.codec.encode_report(block.content)

    def _vardis(self, octets: bytes) -> Iterator[bytes]:
        return self._encoded([Payload(BP_PROTID_VARDIS, octets)])

    def _fitting(self, octets: bytes) -> bytes:
        """Return a truncated frame of one block with the lengths of beacon and block corrected."""
        for _ in range(2):
            anatomy = Anatomy(self.codec, octets)
            for announced in anatomy.announced:
                path = generic(announced.field.path)
                if path in ("bp.length", "payloads[].length") and announced.truth != announced.field.value:
                    octets = anatomy.set_right(announced)
                    break
        return octets

    def _block_header(self, anatomy: Anatomy) -> int:
        first = anatomy.at("payloads[0]")
        assert first is not None
        content = [child for child in first.children if not isinstance(child.layout, Scalar)]
        return content[0].offset - first.offset if content else first.length

    def _header_size(self, container: bytes) -> int:
        """Return the size in octets of the header of a container with one record."""
        anatomy = Anatomy(self.codec, self._envelope([Payload(BP_PROTID_VARDIS, container)]))
        outer, records = anatomy.at("payloads[0].vardis[0]"), anatomy.at("payloads[0].vardis[0].records")
        assert outer is not None
        assert records is not None
        return records.offset - outer.offset

    def _wrong(self, announced: Announced) -> list[bytes]:
        layout, truth = announced.field.layout, announced.truth
        assert isinstance(layout, Scalar)
        top = (1 << (8 * layout.size)) - 1
        values = dict.fromkeys((0, truth + 1, max(0, truth - 1), top, top - 1, (top + 1) // 2))
        return [value.to_bytes(layout.size, layout.order) for value in values if value not in (truth, top + 1)]


class SweepFirst(Joined):
    """A generator that starts with the sweep, ``size`` sequences in each test.

    ``done``: number of its tests that were executed before the campaign was resumed.
    """

    def __init__(self, sequences: Generator, codec: Codec, *, done: int = 0, size: int = 1) -> None:
        super().__init__(sequences, 1)
        swept = Sweep(codec).sequences()
        tests = [list(itertools.chain(*swept[start : start + size])) for start in range(0, len(swept), size)]
        self._left = tests[done:][::-1]

    def draw(self) -> list[Step]:
        """Return the next test."""
        if self._left:
            self.kinds = (NAME,)
            return self._left.pop()
        return super().draw()
