"""The process of atheris: ``python -m dcp_selftest.fuzz.atheris_child SETTINGS [libFuzzer options]``.

libFuzzer does not return from ``Fuzz()``, and ends the process when an input hangs. Therefore it runs in its own
process (started by :mod:`dcp_selftest.fuzz.atheris_engine`), which appends inputs with an effect to a file
and continues.
"""

from __future__ import annotations

import functools
import random
import sys
from pathlib import Path

import msgspec

#: Number of corpus entries whose layout is cached.
_REMEMBERED = 512
_LOOKED_AT = (
    "dcp_codec",
    "dcp_spec",
    "dcp_stack",
    "dcp_conformance.definitions.pics",
    "dcp_conformance.definitions.pics_file",
)
_OURS = ("dcp_lab.testing.mutation", "dcp_lab.testing.mutation_values")


class ChildSettings(msgspec.Struct, frozen=True):
    """Settings of the process, passed as JSON."""

    profile: str
    part: str
    seed: int
    findings: str
    """Path of the file to which the input of each finding is appended, as a line of hexadecimal digits."""


def main(arguments: list[str]) -> None:
    """Fuzz until libFuzzer's limits end the process."""
    import atheris

    # The code that makes inputs must not count as coverage.
    with atheris.instrument_imports(include=list(_LOOKED_AT), exclude=list(_OURS)):
        from dcp_lab.testing.mutation import Mutator

        from dcp_codec.codec import Codec

        from .functions import FunctionTarget

    settings = msgspec.json.decode(arguments[0], type=ChildSettings)
    codec = Codec(settings.profile)
    # The decoder is generated at run time, so instrument_imports does not reach it.
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
        """Mutate by the layout of the beacon, or as libFuzzer does, which also reaches inputs without a layout."""
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
