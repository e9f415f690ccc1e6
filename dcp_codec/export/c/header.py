"""The header of the generated C: constants, structures, declarations."""

from __future__ import annotations

from collections.abc import Iterator

from dcp_spec.profile.definition import Profile

from dcp_codec.export.shape import Record, Shape
from dcp_codec.export.wording import constant, description
from dcp_codec.plan.measures import least_size
from dcp_codec.plan.tree import Group, Node, Scalar

from .names import cite, comment, member_name, plain, stem, value_type


def constants(shape: Shape) -> Iterator[str]:
    """Yield the numbers of protocols and containers, and sizes."""
    for label, number in shape.protocols.items():
        yield f"#define DCP_PROTOCOL_{constant(label)} {number}u"
    ic_type = shape.scalar(shape.container, "icType")
    assert ic_type is not None
    names = ic_type.names or {}
    for number in sorted(shape.records):
        yield f"#define DCP_IC_{constant(names.get(number, shape.records[number].group.type_name))} {number}u"
    yield ""
    yield "/* Octets of records whose texts are empty. */"
    for record in _outer(shape):
        size = sum(least_size(member) for member in record.members)
        yield f"#define DCP_{constant(stem(record.group))}_SIZE {size}u"


def _outer(shape: Shape) -> Iterator[Record]:
    if shape.header is not None:
        yield shape.header
    yield shape.payload
    if shape.srp is not None:
        yield shape.srp
    yield shape.container
    yield from shape.all_records()


class Structures:
    """The structures of all records, each once and before its users."""

    def __init__(self, shape: Shape, profile: Profile) -> None:
        self.shape = shape
        self.profile = profile
        self._done: set[str] = set()

    def text(self) -> str:
        """Return their definitions."""
        lines: list[str] = []
        for record in _outer(self.shape):
            lines += self._structure(record.group, record.members, self._further(record))
        lines += self._beacon()
        return "\n".join(lines)

    def _structure(self, group: Group, members: tuple[Node, ...], further: list[str]) -> list[str]:
        name, lines = stem(group), list[str]()
        if name in self._done:
            return lines
        self._done.add(name)
        for member in members:
            if isinstance(member, Group):
                lines += self._structure(member, member.members, [])
        fields = [line for member in members for line in self._member(member)] + further
        used = [line.split()[-1].rstrip(";").lstrip("*") for line in fields if line.endswith(";")]
        for each in used:
            if used.count(each) > 1:
                raise ValueError(f"{group.type_name}: two members would be called {each}; rename one in the profile")
        lines += comment(f"{group.type_name}: {cite(group.requirement) or 'of this profile'}")
        lines += [f"typedef struct dcp_{name} {{", *fields, f"}} dcp_{name}_t;", ""]
        return lines

    def _member(self, member: Node) -> list[str]:
        text = description(member, self.profile)
        if isinstance(member, Scalar):
            if member.rule is not None and member.rule.value is not None:
                return []
            if member.derived is not None:
                text += "; set by reading, ignored by writing"
            name = member_name(member.name)
            if member.kind == "bytes":
                return [*comment(f"{text}: {member.size} octets", "    "), f"    const uint8_t *{name};"]
            return [*comment(f"{text}{self._range(member)}", "    "), f"    {value_type(member)} {name};"]
        if isinstance(member, Group):
            return [*comment(text, "    "), f"    dcp_{stem(member)}_t {member_name(member.name)};"]
        return [*comment(text, "    "), f"    dcp_octets_t {member_name(member.name)};"]

    @staticmethod
    def _range(scalar: Scalar) -> str:
        if scalar.kind != "int" or scalar.size in (1, 2, 4, 8):
            return ""
        return f" ({scalar.size} octets)"

    def _further(self, record: Record) -> list[str]:
        """Return the members that stand for what follows the header of a payload or container."""
        if record is self.shape.payload:
            lines = [
                "    /* the client payload */",
                "    dcp_octets_t content;",
                "    /* where it begins, counted from the first octet of the beacon */",
                "    size_t content_at;",
            ]
            if self.shape.fill is not None:
                lines += [f"    /* unused rest of the area of {self.shape.fill.total} octets */"]
                lines += ["    dcp_octets_t area;"]
            return lines
        if record is self.shape.container:
            return ["    /* the records, all of the type that ic_type stands for */", "    dcp_list_t records;"]
        return []

    def _beacon(self) -> list[str]:
        lines = ["/* A bearer payload. */", "typedef struct dcp_beacon {"]
        if self.shape.header is not None:
            lines += [f"    dcp_{stem(self.shape.header.group)}_t bp;"]
        return [*lines, "    dcp_list_t payloads;", "} dcp_beacon_t;"]


def declarations(shape: Shape) -> str:
    """Return the functions with their comments."""
    read, write = [_READ_BEACON], [_WRITE]
    if shape.srp is not None:
        name = stem(shape.srp.group)
        read.append(
            "/* Read the content of a payload of protocol SRP. False: it is not exactly one record. */\n"
            f"bool dcp_read_{name}(const uint8_t *octets, size_t size, dcp_{name}_t *report,\n"
            f"{' ' * (len(name) + 15)}dcp_problem_t *problem);\n"
        )
    read.append(_READ_CONTAINERS)
    header = "" if shape.header is None else f", const dcp_{stem(shape.header.group)}_t *bp"
    write.append(f"bool dcp_begin_beacon(dcp_writer_t *w{header});")
    write.append(_WRITE_PAYLOADS)
    if shape.srp is not None:
        name = stem(shape.srp.group)
        write.append(f"bool dcp_add_{name}(dcp_writer_t *w, const dcp_{name}_t *report);")
    write.append(_WRITE_CONTAINERS)
    return "\n".join([*read, "", *write])


def heading(profile: Profile, version: str, options: str = "") -> str:
    """Return the first comment of both files."""
    return "\n".join(
        comment(
            f"Codec of the Drone Coordination Protocol, {profile.title} (profile {profile.name}). "
            f"Generated by dcp-codec {version}: dcp-codec export c --profile {plain(profile.name)}{options}"
        )
    )


_READ_BEACON = """/* Read the header of a bearer payload. Octets after the beacon are padding of the bearer.
 * True: beacon->payloads can be read. False: problem says why these octets are not a beacon. */
bool dcp_read_beacon(const uint8_t *octets, size_t size, dcp_beacon_t *beacon, dcp_problem_t *problem);

/* Read the next payload, without looking into its content. False: there is none (problem->reason is DCP_OK), or the
 * rest of the beacon is wrong. */
bool dcp_next_payload(dcp_list_t *payloads, dcp_payload_t *payload, dcp_problem_t *problem);

/* Check a bearer payload with the contents of all its payloads, and report the first problem. If there is none,
 * problem->offset is the number of octets of the beacon. */
bool dcp_check_beacon(const uint8_t *octets, size_t size, dcp_problem_t *problem);
"""
_READ_CONTAINERS = """/* Return the containers in the content of a payload of protocol VarDis. */
dcp_list_t dcp_containers(const uint8_t *octets, size_t size);

/* Read the next container and check all its records. False: there is none (problem->reason is DCP_OK), or the rest is
 * wrong. Offsets of problems count from the first octet of the content. */
bool dcp_next_container(dcp_list_t *containers, dcp_container_t *container, dcp_problem_t *problem);
"""
_WRITE = """/* Begin to write into a buffer. */
void dcp_write_to(dcp_writer_t *w, uint8_t *octets, size_t size);

/* Begin and end a bearer payload; w->at is then its size. Every payload is begun and ended in it. */"""
_WRITE_PAYLOADS = """bool dcp_end_beacon(dcp_writer_t *w);
bool dcp_begin_payload(dcp_writer_t *w, const dcp_payload_t *payload);
bool dcp_end_payload(dcp_writer_t *w, const dcp_payload_t *payload);

/* Add to the content of a payload: octets, a state report, or containers. Contents can also be written without a
 * beacon around them. Pointers that are null stand for zeros. */
bool dcp_add_octets(dcp_writer_t *w, const uint8_t *octets, size_t size);"""
_WRITE_CONTAINERS = """bool dcp_begin_container(dcp_writer_t *w, const dcp_container_t *container);
bool dcp_end_container(dcp_writer_t *w);"""
