"""Variants that follow other alternatives of the readings of contradictory text than the reference node."""

from __future__ import annotations

from collections.abc import Callable, Iterator

from dcp_conformance.reference.surroundings import Setup
from dcp_spec.catalogue.readings import readings
from dcp_spec.constants import SpecVersion

from dcp_selftest.generated.trial import OVERRIDDEN

from .variant import Variant, anywhere, has_srp, setup

_V = SpecVersion

#: First and last version (None: no last one) in which the alternatives of a reading differ; others differ in all.
_VERSIONS: dict[str, tuple[SpecVersion, SpecVersion | None]] = {
    "X02": (_V.V1_2, None),  # there is a length field since 1.2
    "X03": (_V.V1_1, None),  # 1.0 begins with 1 anyway
    "X05": (_V.V1_1, None),
    "X20": (_V.V2_0, None),
    "X26": (_V.V2_0, None),
    "X27": (_V.V2_0, None),
    "X30": (_V.V1_2, None),  # 1.0 and 1.1 require an answer
    "X34": (_V.V1_2, None),  # 1.0 and 1.1 specify the behaviour
    "X36": (_V.V2_0, None),
    "X37": (_V.V1_2, None),
    "X38": (_V.V2_0, None),
    "X31": (_V.V2_0, None),  # before, the number in the text is that of the version
    "X44": (_V.V1_1, None),  # 1.0 never puts several payloads of a client into a beacon
    "X47": (_V.V1_0, _V.V1_1),  # later there is a length field
}
#: Inconclusive verdicts that follow from the alternative.
_EXPLAINS: dict[str, tuple[str, ...]] = {}


def _variants() -> Iterator[Variant]:
    for reading in readings().values():
        since, until = _VERSIONS.get(reading.id, (_V.V1_0, None))
        for alternative in reading.alternatives[1:]:
            yield Variant(
                f"V-{reading.id}-{alternative.name}",
                f"reads {reading.title[0].lower()}{reading.title[1:]} differently: {alternative.description}",
                reading.id,
                _choose(reading.id, alternative.name),
                since,
                until,
                _EXPLAINS.get(f"{reading.id}-{alternative.name}", ()),
                has_srp if reading.id == "X10" else anywhere,
            )
        if reading.alternatives and reading.id == "X28":
            # Profiles choose an alternative of this reading; the first one is not the default of all profiles.
            yield Variant(
                "V-X28-half-range-neither",
                f"reads {reading.title.lower()} as: {reading.alternatives[0].description}",
                reading.id,
                _choose(reading.id, reading.alternatives[0].name),
            )


def _choose(reading: str, name: str) -> Callable[[str], Setup]:
    def build(profile: str) -> Setup:
        return setup(profile, readings={reading: name})

    return build


def _every_other(profile: str) -> Setup:
    """Return a node that follows the second alternative of every reading of the version."""
    version = setup(profile).config.features.version
    chosen = {}
    for reading in readings().values():
        since, until = _VERSIONS.get(reading.id, (_V.V1_0, None))
        if reading.alternatives and version.is_within(since, until):
            chosen[reading.id] = reading.alternatives[1].name
    return setup(profile, readings=chosen, declared=chosen.keys() - OVERRIDDEN)


VARIANTS = (
    *_variants(),
    Variant("V-X-every-other", "follows the second alternative of every reading that has one", "all readings",
        _every_other),
)  # fmt: skip
