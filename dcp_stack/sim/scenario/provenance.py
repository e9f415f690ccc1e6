"""What a result was made from, so that it can be understood and repeated without the command line that made it."""

from __future__ import annotations

import hashlib
import platform
import random
from typing import Any

import msgspec
from dcp_spec.version import __version__

from dcp_codec.codec import Codec
from dcp_stack.config import NodeConfig
from dcp_stack.node import Node
from dcp_stack.sim.virtual.network import node_id

from .definition import Scenario


class Provenance(msgspec.Struct, frozen=True):
    """Scenario with all keys, the parameters that follow from it, and the program that played it."""

    kit_version: str
    python_version: str
    scenario_sha256: str
    """Of the scenario with all keys, the parameters and the wire profile; without the seed, so that runs that differ
    by the seed alone have the same."""
    profile_sha256: str
    """Of the content of the wire profile."""
    scenario: dict[str, Any]
    parameters: dict[str, dict[str, Any]]
    """What each node starts with, by protocol, under the specification's names."""

    @classmethod
    def of(cls, scenario: Scenario, codec: Codec) -> Provenance:
        """The provenance of a run of this scenario."""
        plain: dict[str, Any] = msgspec.to_builtins(scenario)
        profile = msgspec.json.encode(codec.profile, order="sorted", enc_hook=str)
        parameters = effective_parameters(scenario, codec)
        hashed = {**plain, "parameters": parameters}
        # The content of the profile counts, and not where its file is; the title is said and changes nothing.
        for key in ("seed", "title", "profile"):
            del hashed[key]
        return cls(
            kit_version=__version__,
            python_version=platform.python_version(),
            scenario_sha256=hashlib.sha256(msgspec.json.encode(hashed, order="sorted") + profile).hexdigest(),
            profile_sha256=hashlib.sha256(profile).hexdigest(),
            scenario=plain,
            parameters=parameters,
        )


def effective_parameters(scenario: Scenario, codec: Codec) -> dict[str, dict[str, Any]]:
    """The parameters of a node of this scenario, those included that the profile decides."""
    config = NodeConfig(
        node_id=node_id(codec.profile, 0),
        codec=codec,
        bp=scenario.bp,
        srp=scenario.srp_config,
        vardis=scenario.vardis_config,
    )
    node = Node(config, rng=random.Random(0), now=0, wall=0)  # noqa: S311 - it never runs
    entities = (("bp", node.bp), ("srp", node.srp), ("vardis", node.vardis))
    # The identifier is the one parameter that differs from node to node.
    return {
        name: {key: value for key, value in entity.parameters().items() if not isinstance(value, bytes)}
        for name, entity in entities
        if entity is not None
    }
