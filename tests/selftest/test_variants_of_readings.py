"""Each alternative of each reading in the catalogue is followed by a permitted variant."""

from __future__ import annotations

import inspect
import pkgutil
import re
from importlib import import_module

import msgspec
import pytest
from dcp_selftest import variants
from dcp_selftest.runner import PROFILES
from dcp_selftest.variants import Variant, all_variants
from dcp_selftest.variants.variant import variants_of
from dcp_spec.catalogue.readings import readings

from dcp_stack.readings import Readings

#: Alternatives that no variant follows, as ``<reading> <alternative>``, with the reason.
EXEMPT: dict[str, str] = {}
#: Follows many readings at once: what one of them changes may be hidden by another.
MANY = "V-X-every-other"

ALTERNATIVES = [(each.id, one.name) for each in readings().values() for one in each.alternatives]


def _source_of_the_node() -> str:
    packages = ("dcp_stack", "dcp_stack.bp", "dcp_stack.srp", "dcp_stack.vardis")
    return "\n".join(
        inspect.getsource(import_module(f"{package}.{info.name}"))
        for package in packages
        for info in pkgutil.iter_modules(import_module(package).__path__)
        if not info.ispkg
    )


def _beside_the_node() -> list[Variant]:
    """Variants that replace a part of our node, or its upper tester."""
    return [
        each
        for info in pkgutil.iter_modules(variants.__path__)
        if info.name != "readings"
        for each in variants_of(import_module(f"{variants.__name__}.{info.name}"))
    ]


@pytest.fixture(scope="module")
def followed() -> dict[tuple[str, str], list[str]]:
    """The variants that follow an alternative, alone, on a profile that they apply to."""
    found: dict[tuple[str, str], list[str]] = {}
    for each in all_variants().values():
        profile = next((name for name in reversed(PROFILES) if each.applies_to(name)), None)
        if profile is None or each.id == MANY:
            continue
        chosen = each.build(profile).config.readings
        for reading, name in chosen.items():
            found.setdefault((reading, name), []).append(each.id)
    return found


@pytest.mark.parametrize(("reading", "name"), ALTERNATIVES)
def test_an_alternative_has_a_variant(reading: str, name: str, followed: dict[tuple[str, str], list[str]]):
    if f"{reading} {name}" in EXEMPT:
        return
    default = readings()[reading].default
    # Our node follows the first one without being told.
    ours = default is not None and name == default.name
    assert ours or followed.get((reading, name)) or f"V-{reading}-{name}" in {each.id for each in _beside_the_node()}


def test_a_choice_that_the_node_ignores_is_not_a_variant():
    """A configuration can choose any reading of the catalogue; only those that the node asks for change anything."""
    source = _source_of_the_node()
    fields = msgspec.structs.fields(Readings)
    asked = {each.encode_name for each in fields if re.search(rf"readings\.{each.name}\b", source)}
    elsewhere = {match[1] for each in _beside_the_node() if (match := re.match(r"V-([A-Z]\d+)-", each.id))}
    ignored = {reading for reading, _ in ALTERNATIVES} - asked - elsewhere
    assert ignored == {each.partition(" ")[0] for each in EXEMPT} & ignored


def test_exemptions_are_of_existing_alternatives():
    assert set(EXEMPT) <= {f"{reading} {name}" for reading, name in ALTERNATIVES}
    assert all(EXEMPT.values())
