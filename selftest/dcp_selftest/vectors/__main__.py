"""Write the digests of all test vectors: ``python -m dcp_selftest.vectors``."""

from __future__ import annotations

from pathlib import Path

import dcp_conformance
import msgspec
from dcp_conformance.vectors import wire
from dcp_conformance.vectors.behaviour import load
from dcp_conformance.vectors.files import behaviour_digests, wire_digests
from dcp_spec.profile.loading import profile_names

from dcp_codec import get_codec

PATH = Path(dcp_conformance.__file__).parent / "data" / "vector-digests.json"


def main() -> None:
    """Write the file."""
    found = {}
    for name in profile_names():
        digests = wire_digests(wire.vectors(get_codec(name)))
        if (behaviour := load(name)) is not None:
            digests[f"{name}/behaviour"] = behaviour_digests(behaviour)
        found[name] = {message: "".join(each) for message, each in digests.items()}
    PATH.write_bytes(msgspec.json.format(msgspec.json.encode(found), indent=0) + b"\n")


if __name__ == "__main__":
    main()
