"""The shape of a beacon for generators of codecs in other languages: the roles of the parts of a plan.

A plan is a general tree, but every profile fills the same roles: header, payloads, containers, records. A codec in
another language has one function for each role, and reads a record as runs of scalars with texts between them.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

from dcp_codec.codec import Codec
from dcp_codec.plan.measures import largest
from dcp_codec.plan.tree import Exact, Fill, Group, Many, Node, Region, Rest, Scalar, Select, Text

Node_co = TypeVar("Node_co", bound=Scalar | Text, covariant=True)


class Part(NamedTuple, Generic[Node_co]):
    """A scalar or text of a record, or a length of a text, with the names that lead to it."""

    path: tuple[str, ...]
    node: Node_co

    @property
    def name(self) -> str:
        """Return the path as errors print it."""
        return ".".join(self.path)


class Run(NamedTuple):
    """Neighbouring scalars, whose octets are checked at once; the lengths of ``text``, if there is one, end it."""

    scalars: tuple[Part[Scalar], ...]
    text: Part[Text] | None

    @property
    def size(self) -> int:
        """Return the number of octets of the scalars."""
        return sum(part.node.size for part in self.scalars)


@dataclass(frozen=True, slots=True)
class Record:
    """A record without lists: its name in the specification, and its members in wire order."""

    group: Group
    members: tuple[Node, ...]
    #: Names between the last list and the record, in the paths of errors.
    path: tuple[str, ...] = ()

    def parts(self) -> Iterator[Part[Scalar | Text]]:
        """Yield scalars and texts in wire order, those of inner records too."""
        yield from _parts(self.members, ())

    def runs(self) -> Iterator[Run]:
        """Yield the runs in wire order."""
        scalars: list[Part[Scalar]] = []
        for part in self.parts():
            if isinstance(part.node, Text):
                scalars += (Part((*part.path, prefix.name), prefix) for prefix in part.node.prefixes)
                yield Run(tuple(scalars), Part(part.path, part.node))
                scalars = []
            else:
                scalars.append(Part(part.path, part.node))
        if scalars:
            yield Run(tuple(scalars), None)


def _parts(members: tuple[Node, ...], path: tuple[str, ...]) -> Iterator[Part[Scalar | Text]]:
    for member in members:
        if isinstance(member, Group):
            yield from _parts(member.members, (*path, member.name))
        elif isinstance(member, Scalar | Text):
            yield Part((*path, member.name), member)
        else:
            raise TypeError(f"{member.name}: a list or region inside a record")


@dataclass(frozen=True, slots=True)
class Shape:
    """The parts of a beacon by role."""

    beacon: Group
    header: Record | None
    region: Region | None
    """The payloads fill it; None: they are counted, or end with the octets."""
    payloads: Many
    payload: Record
    """Its members before the content."""
    content: Region
    fill: Fill | None
    protocols: Mapping[str, int]
    vardis: Many
    srp: Record | None
    srp_exact: Exact | None
    """The check of a report of fixed size."""
    container: Record
    """Its members before the records."""
    list_region: Region | None
    select: Select
    records: Mapping[int, Record]
    """By container type."""

    def all_records(self) -> list[Record]:
        """Return the distinct records of containers, in the order of their types."""
        return list(self.records.values())

    @staticmethod
    def scalar(record: Record, name: str) -> Scalar | None:
        """Return a scalar of a record by its name in the specification; None if the layout has none."""
        return next((each for each in record.members if each.name == name and isinstance(each, Scalar)), None)

    @staticmethod
    def derived(record: Record, name: str) -> Scalar | None:
        """Return a scalar that follows from others, such as a length; None if the layout has none."""
        found = Shape.scalar(record, name)
        return None if found is None or found.derived is None else found

    @property
    def most_records(self) -> int:
        """Return the most records that a container can count."""
        count = self.scalar(self.container, "icNumRecords")
        assert count is not None
        return largest(count)

    @property
    def header_marks(self) -> dict[str, str]:
        """Return the fields of the header whose place is kept for later checks, with the names of variables for it."""
        length = {} if self.region is None else {self.region.length.rsplit(".", 1)[-1]: "length_at"}
        return {"numPayloads": "count_at", **length}

    @property
    def container_marks(self) -> dict[str, str]:
        """Return the same of the header of a container."""
        return {"icType": "type_at", **({} if self.list_region is None else {self.list_region.length: "length_at"})}


def shape_of(codec: Codec) -> Shape:
    """Return the shape of the beacons of a profile. Raises TypeError for a plan with other roles."""
    beacon = codec.beacon_plan
    if not isinstance(beacon, Group):
        raise TypeError("a beacon must be a record")
    *before, last = beacon.members
    header = before[0] if before else None
    if len(before) > 1 or not (header is None or isinstance(header, Group)):
        raise TypeError("a beacon must be a header and a list")
    region = last if isinstance(last, Region) else None
    payloads = region.content if region else last
    assert isinstance(payloads, Many)
    payload = payloads.element
    index, content = next((i, each) for i, each in enumerate(payload.members) if isinstance(each, Region))
    behind = payload.members[index + 1 :]
    fill = behind[0] if behind else None
    select = content.content
    if not isinstance(select, Select) or not isinstance(select.default, Rest):
        raise TypeError("the content of a payload must depend on its protocol, and may be octets")
    assert fill is None or (isinstance(fill, Fill) and len(behind) == 1)
    vardis = next(case for case in select.cases.values() if isinstance(case, Many))
    report = next((case for case in select.cases.values() if not isinstance(case, Many)), None)
    group = report.content if isinstance(report, Exact) else report
    assert group is None or isinstance(group, Group)
    place, records = next(
        (i, each) for i, each in enumerate(vardis.element.members) if isinstance(each, Region | Select)
    )
    choice = records.content if isinstance(records, Region) else records
    assert isinstance(choice, Select)
    lists = {number: case for number, case in choice.cases.items() if isinstance(case, Many)}
    assert len(lists) == len(choice.cases)
    return Shape(
        beacon=beacon,
        header=Record(header, header.members, (header.name,)) if isinstance(header, Group) else None,
        region=region,
        payloads=payloads,
        payload=Record(payload, payload.members[:index]),
        content=content,
        fill=fill if isinstance(fill, Fill) else None,
        protocols={case.name: number for number, case in select.cases.items()},
        vardis=vardis,
        srp=Record(group, group.members, (report.name,)) if group is not None and report is not None else None,
        srp_exact=report if isinstance(report, Exact) else None,
        container=Record(vardis.element, vardis.element.members[:place]),
        list_region=records if isinstance(records, Region) else None,
        select=choice,
        records={number: Record(lists[number].element, lists[number].element.members) for number in sorted(lists)},
    )
