"""Generate the tables of ``docs/hazards.md`` from explorations: ``python -m tools.docs.hazards``.

The block ``closed`` takes a minute and has CPU times; :func:`checked` has the others.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path

import msgspec
from dcp_lab.explore.hazards import hazard_of
from dcp_lab.explore.proposals import PROPOSALS
from dcp_lab.explore.search import Result, Search, Violation
from dcp_lab.explore.space import Space
from dcp_lab.explore.trace import chart, trace
from dcp_lab.explore.trace import table as steps
from dcp_spec.catalogue.readings import readings
from dcp_spec.constants import SpecVersion
from dcp_spec.markdown import table

from dcp_stack.config import VardisConfig
from dcp_stack.record_sizes import RecordSizes

PAGE = Path(__file__).parents[2] / "docs" / "hazards.md"
_WRAPPING = VardisConfig(seqno_modulus=4)
#: Spaces that together have all hazards of 2.0; the proposals are explored in them.
SMALL = (
    Space(nodes=3, creations=2, updates=1),
    Space(nodes=3, deletions=1),
    Space(nodes=2, creations=2, updates=1, restarts=1),
    Space(nodes=3, producers=2, creations=2, deletions=1),
    Space(nodes=2, creations=2, restarts=1, clock_steps=2),
    Space(nodes=2, updates=1, silences=2),
    Space(nodes=2, updates=3, vardis=_WRAPPING),
)
#: Further spaces for the unchanged text.
_FURTHER = (
    Space(nodes=3, creations=2, updates=1, deletions=1),
    Space(nodes=3, creations=2, deletions=1, repetitions=2),
)
#: Larger spaces, for the claim that there is nothing else.
LARGE = (
    Space(nodes=3, creations=2, updates=2, deletions=1, restarts=1),
    Space(nodes=3, creations=2, updates=1, deletions=1, repetitions=2),
    Space(nodes=3, producers=2, creations=2, updates=1, deletions=1),
    Space(nodes=4, creations=1, updates=1, deletions=1),
    Space(nodes=4, creations=2, updates=1, losses=2, partitions=1),
)
_VERSIONS = tuple(SpecVersion)


def explored(space: Space) -> tuple[Search, Result]:
    """Return the exploration of a space."""
    return _explored(msgspec.json.encode(space))


@cache
def _explored(space: bytes) -> tuple[Search, Result]:
    search = Search(msgspec.json.decode(space, type=Space))
    return search, search.run()


def _found(space: Space) -> dict[str, list[Violation]]:
    """Return the violations in a space by hazard."""
    search, result = explored(space)
    found: dict[str, list[Violation]] = {}
    for each in result.violations:
        name = hazard_of(each, search.cores.codec.profile.spec_version) or f"new ({each.name})"
        found.setdefault(name, []).append(each)
    return found


def _small(version: SpecVersion = SpecVersion.V2_0, proposal: str = "") -> list[Space]:
    return [
        msgspec.structs.replace(space, profile=f"dcp-{version}", proposal=proposal)
        for space in (SMALL if proposal else (*SMALL, *_FURTHER))
        if not (space.silences and version < SpecVersion.V2_0)
    ]


def _in_order(names: set[str]) -> list[str]:
    return sorted(names, key=lambda name: (name[0] != "H", int(name[1:]) if name[1:].isdigit() else 0, name))


def checked() -> dict[str, str]:
    """Return all blocks except ``closed``, by name."""
    by_version = {version: set().union(*map(_found, _small(version))) for version in _VERSIONS}
    names = _in_order(set().union(*by_version.values()))
    return {
        "hazards": _hazards(names, by_version),
        "sequences": "\n\n".join(_sequences(names)),
        "proposals": _proposals(),
        "texts": "\n".join(f"* **{name}**: {each.text}" for name, each in PROPOSALS.items()),
        "octets": _octets(),
    }


def _first(name: str) -> tuple[Space, Violation]:
    """Return the shortest violation of a hazard, of the latest version that has it."""
    for version in reversed(_VERSIONS):
        found = [(space, each) for space in _small(version) for each in _found(space).get(name, ())]
        if found:
            return min(found, key=lambda pair: (len(pair[1].steps), pair[0].nodes))
    raise LookupError(name)


def _hazards(names: list[str], by_version: Mapping[SpecVersion, set[str]]) -> str:
    rows = []
    for name in names:
        _, violation = _first(name)
        having = [version for version, found in by_version.items() if name in found]
        until = "" if having[-1] == _VERSIONS[-1] else f" to {having[-1]}"
        kinds = ", ".join(sorted(violation.kinds))
        rows.append(
            [name, readings()[name].title, f"{having[0]}{until or ' and later'}", len(violation.steps), f"{kinds}"]
        )
    return table(["", "hazard", "versions", "steps", "events"], rows, "lllrl")


def _sequences(names: list[str]) -> Iterator[str]:
    for name in names:
        space, violation = _first(name)
        search, _ = explored(space)
        found, entry = trace(search, violation), readings()[name]
        yield f"### {name}: {entry.title}"
        yield f"{entry.problem}"
        header, rows = steps(found, space.nodes)
        version = search.cores.codec.profile.spec_version
        yield f"{version}, `{violation.name}`:"
        yield table(header, rows)
        yield "```\n" + "\n".join(chart(found, space.nodes)) + "\n```"


def _proposals() -> str:
    text: set[str] = set().union(*map(_found, SMALL))
    rows = []
    for name, proposal in PROPOSALS.items():
        spaces = _small(proposal=name)
        found: set[str] = set().union(*map(_found, spaces))
        states = sum(explored(space)[1].states for space in spaces)
        brought = {f"{hazard} ({', '.join(sorted(kinds))})" for hazard, kinds in _brought(spaces)}
        cells = (text - found, brought, found)
        rows.append(
            [f"**{name}**: {proposal.title}", *(", ".join(_in_order(each)) or "-" for each in cells), f"{states:,}"]
        )
    return table(["proposal", "removes", "brings", "hazards found", "states"], rows, "llllr")


def _brought(spaces: list[Space]) -> Iterator[tuple[str, frozenset[str]]]:
    """Yield hazards with causes that no cause in the text explains: there is none with the same or fewer events."""
    for space in spaces:
        before = {
            (each.name, each.kinds)
            for violations in _found(msgspec.structs.replace(space, proposal="")).values()
            for each in violations
        }
        for hazard, violations in _found(space).items():
            for each in violations:
                if not any(name == each.name and kinds <= each.kinds for name, kinds in before):
                    yield hazard, each.kinds


def _octets() -> str:
    rows = []
    for name in ("", "creation-times", "deletions"):
        codec = PROPOSALS[name].codec("dcp-2.0") if name else explored(SMALL[0])[0].cores.codec
        sizes = RecordSizes(codec)
        fixed = {str(getattr(kind, "label", kind)): size for kind, size in sizes.fixed.items()}
        summaries = sizes.ic_header + 20 * sizes.var_summ
        rows.append(
            [
                name or "2.0",
                sizes.var_create,
                sizes.var_update,
                sizes.var_summ,
                fixed["DELETE-VARIABLES"],
                fixed["REQUEST-VARUPDATES"],
                fixed["REQUEST-VARCREATES"],
                summaries,
            ]
        )
    columns = ["", "VarCreate", "VarUpdate", "VarSumm", "VarDelete", "VarReqUpdate", "VarReqCreate", "20 summaries"]
    return table(columns, rows, "lrrrrrrr")


def closed() -> str:
    """Return the table of the large spaces, with CPU seconds."""
    rows = []
    for space in LARGE:
        for profile, proposal in (("dcp-2.0", ""), ("dcp-1.3", ""), ("dcp-2.0", "all")):
            it = msgspec.structs.replace(space, profile=profile, proposal=proposal)
            _, result = explored(it)
            assert result.complete
            hazards = ", ".join(_in_order(set(_found(it)))) or "none"
            numbers = [f"{each:,}" for each in (result.states, result.transitions, result.depth)]
            name = profile.removeprefix("dcp-") + (f", {proposal}" if proposal else "")
            rows.append([space.bounds, name, *numbers, f"{result.seconds:.1f}", hazards])
    return table(["space", "text", "states", "transitions", "steps", "CPU s", "hazards found"], rows, "llrrrrl")


def filled(page: str, blocks: Mapping[str, str]) -> str:
    """Return a page with new content of blocks."""
    for name, content in blocks.items():
        begin, end = f"<!-- {name}: made by tools/docs/hazards.py -->", f"<!-- end of {name} -->"
        pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
        assert pattern.search(page), f"the page has no block {name}"
        page = pattern.sub(lambda _: f"{begin}\n\n{content}\n\n{end}", page)  # noqa: B023 - called at once
    return page


if __name__ == "__main__":
    PAGE.write_text(filled(PAGE.read_text(encoding="utf-8"), {**checked(), "closed": closed()}), encoding="utf-8")
