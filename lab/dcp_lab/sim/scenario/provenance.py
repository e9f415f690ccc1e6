"""The provenance of a result: all inputs of the run, so that it can be repeated without the original command line."""

from __future__ import annotations

import hashlib
import platform
from typing import Any

import msgspec
from dcp_spec.version import __version__

from dcp_codec.codec import Codec

from .definition import Scenario
from .loading import trial_node


class Provenance(msgspec.Struct, frozen=True):
    """The scenario with all keys, the resulting parameters of the nodes, and the versions of the software."""

    kit_version: str
    python_version: str
    scenario_sha256: str
    """Hash of the scenario with all keys, the parameters and the wire profile.

    It excludes seed and title, so runs that differ only in the seed have the same hash.
    """
    profile_sha256: str
    """Hash of the content of the wire profile."""
    scenario: dict[str, Any]
    parameters: dict[str, dict[str, Any]]
    """The initial parameters of each node, by protocol and the specification's names."""

    @classmethod
    def of(cls, scenario: Scenario, codec: Codec) -> Provenance:
        """Return the provenance of a run of this scenario."""
        plain: dict[str, Any] = msgspec.to_builtins(scenario)
        profile = msgspec.json.encode(codec.profile, order="sorted", enc_hook=str)
        parameters = effective_parameters(scenario, codec)
        hashed = {**plain, "parameters": parameters}
        if scenario.radio is not None and (model := scenario.radio.model_sha256()) is not None:
            hashed["radio"] = {**plain["radio"], "model": model}
        # The hash covers the content of profile and model, not the paths of their files. The title has no effect.
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
    """Return the parameters of a node of this scenario by protocol, including defaults from the profile."""
    node = trial_node(scenario, codec)
    entities = (("bp", node.bp), ("srp", node.srp), ("vardis", node.vardis))
    # The identifier is the one parameter that differs from node to node.
    return {
        name: {key: value for key, value in entity.parameters().items() if not isinstance(value, bytes)}
        for name, entity in entities
        if entity is not None
    }
