"""Modules that every trial needs besides the node, imported once in the process from which trials are forked."""

import dcp_conformance.execution.runner  # noqa: F401 - for those that are forked

import dcp_codec.codec

from .trial import PROFILES, cases

cases()
for _name in PROFILES:
    dcp_codec.codec.get_codec(_name)
