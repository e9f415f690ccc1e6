"""The process of atheris: ``python -m dcp_conformance.fuzz.execute.atheris_child SETTINGS [libFuzzer options]``.

libFuzzer takes the process over: it does not come back from ``Fuzz()``, and ends the process when an input hangs. So it
has one of its own (:mod:`dcp_conformance.fuzz.execute.atheris_engine`), which writes down inputs that show something
and goes on.
"""

from __future__ import annotations

import functools
import random
import sys
from pathlib import Path

import msgspec

#: Corpus entries of which the layout is remembered.
_REMEMBERED = 512
_LOOKED_AT = ("dcp_codec", "dcp_spec", "dcp_stack", "dcp_conformance.model.pics", "dcp_conformance.model.pics_file")
_OURS = ("dcp_codec.testing.mutation", "dcp_codec.testing.mutation_values")


class ChildSettings(msgspec.Struct, frozen=True):
    """What the process has to know."""

    profile: str
    part: str
    seed: int
    findings: str
    """A file, to which the input of each finding is added: a line in hex."""


def main(arguments: list[str]) -> None:
    """Fuzz until libFuzzer's limits end the process."""
    import atheris

    # What makes inputs is not what is looked at.
    with atheris.instrument_imports(include=list(_LOOKED_AT), exclude=list(_OURS)):
        from dcp_codec.codec import Codec
        from dcp_codec.testing.mutation import Mutator

        from .functions import FunctionTarget

    settings = msgspec.json.decode(arguments[0], type=ChildSettings)
    codec = Codec(settings.profile)
    # Generated when it is first needed, which is not when it is imported.
    atheris.instrument_func(codec._decode_beacon)
    target = FunctionTarget(codec)
    seen: set[str] = set()

    def one(octets: bytes) -> None:
        effect = target.once(settings.part, octets)
        if effect is not None and effect.signature not in seen:
            seen.add(effect.signature)
            with Path(settings.findings).open("a") as file:
                file.write(octets.hex() + "\n")

    rng = random.Random(settings.seed)  # noqa: S311 - the same every time, no secret

    @functools.lru_cache(_REMEMBERED)
    def mutator_of(octets: bytes) -> Mutator:
        return Mutator(codec, rng, [octets])

    def mutate(octets: bytes, most: int, seed: int) -> bytes:
        """By the layout, or as libFuzzer does: that finds what no layout knows of."""
        rng.seed(seed)
        if octets and seed & 1:
            return mutator_of(octets).mutate().octets[:most]
        changed: bytes = atheris.Mutate(octets, most)
        return changed

    by_layout = {"custom_mutator": mutate} if settings.part == "beacon" else {}
    atheris.Setup([sys.argv[0], *arguments[1:]], one, **by_layout)
    atheris.Fuzz()


if __name__ == "__main__":
    main(sys.argv[1:])
