"""Each requirement of the catalogue names the statements of the specification from which it is derived."""

from __future__ import annotations

import re
from pathlib import Path

from dcp_selftest.provenance.anchors import PATH, read_anchors
from dcp_spec.catalogue.origins import Origin, Section, link, newest_statements, origins, revisions
from dcp_spec.catalogue.requirements import requirements
from dcp_spec.constants import SpecVersion

ROOT = Path(__file__).parents[2]
HINT = f"add it to {PATH} and run dcp-selftest origins REPOSITORY (docs/provenance.md)"


def anchors_above(section: Section) -> set[str]:
    """The anchors of a section and of those around it."""
    known = {(each.file, each.headings): each.anchor for each in newest_statements().sections}
    return {known.get((section.file, section.headings[:depth]), "") for depth in range(len(section.headings) + 1)} | {
        section.anchor
    }


def lies_in(origin: Origin, place: str) -> bool:
    """Whether an origin lies in a place as the catalogue writes it: ``file#anchor`` or ``file: Heading``."""
    file, anchor, name = place.partition("#")
    if not anchor:
        file, _, name = place.partition(": ")
        return origin.section.file == file and name.replace("`", "") in origin.section.headings
    return origin.section.file == file and name in anchors_above(origin.section)


def steps(text: str) -> set[str]:
    """The steps that ``3``, ``3.d`` or ``5-16`` mean."""
    match = re.fullmatch(r"(\d+)(?:-(\d+))?", text)
    return {str(each) for each in range(int(match[1]), int(match[2] or match[1]) + 1)} if match else {text}


def test_the_versions_are_those_of_the_catalogue():
    assert [each.version for each in revisions()] == sorted(SpecVersion, reverse=True)
    assert all(re.fullmatch("[0-9a-f]{40}", each.commit) for each in revisions())
    assert newest_statements().version == revisions()[0].version


def test_the_generated_file_matches_the_anchors():
    anchors = read_anchors(ROOT / PATH)
    recorded = {
        name: {each.version: [f"{o.section.file}:{o.line} {o.fingerprint}" for o in places.origins[each.version]]
               for each in revisions() if each.version in places.origins}
        for name, places in origins().items()
    }  # fmt: skip
    for name, versions in anchors.statements.items():
        for version, statements in versions.items():
            if requirements()[name].holds_in(version):
                assert recorded[name][version] == list(statements), f"{name} in {version}: {HINT}"
    assert {name: entry.why for name, entry in origins().items() if entry.why} == anchors.why


def test_every_requirement_has_an_origin_in_each_of_its_versions():
    for name, requirement in requirements().items():
        entry = origins()[name]
        holds = {version for version in SpecVersion if requirement.holds_in(version)}
        assert set(entry.origins) == holds, f"{name}: {HINT}"
        for version, places in entry.origins.items():
            assert places or entry.why, f"{name} in {version} has neither a statement nor a reason: {HINT}"
            assert len({(each.section, each.line, each.fingerprint) for each in places}) == len(places), name


def test_the_section_and_the_steps_are_those_of_the_catalogue():
    for name, entry in origins().items():
        if entry.why:
            continue
        requirement = requirements()[name]
        places = entry.origins[max(entry.origins)]
        inside = [each for each in places if lies_in(each, requirement.section)]
        assert inside, f"{name}: none of {', '.join(map(str, places))} lies in {requirement.section}"
        for further in requirement.see:
            assert any(lies_in(each, further) for each in places), f"{name}: nothing lies in {further}"
        if requirement.step is not None:
            found = {each.step for each in inside if each.step}
            if "." not in requirement.step:
                found = {each.partition(".")[0] for each in found}
            wanted = steps(requirement.step)
            # A step in between that only fetches an entry states nothing.
            assert found <= wanted, name
            ends = wanted if "." in requirement.step else {min(wanted, key=int), max(wanted, key=int)}
            assert ends <= found, name


def test_derived_requirements_are_marked_as_not_stated():
    for name, requirement in requirements().items():
        if requirement.derived:
            assert origins()[name].why, name


def test_the_links_lead_to_a_line():
    place = origins()["BP-RX-06"].origins[SpecVersion("2.0")][0]
    assert re.search(r"/blob/[0-9a-f]{40}/.*/dcp-bp\.md\?plain=1#L\d+$", link(place))
