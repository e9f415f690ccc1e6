"""What every trial needs beside the node, imported once: trials are forked from a process that has this module."""

import dcp_codec.codec
import dcp_conformance.execution.runner  # noqa: F401 - for those that are forked

from .trial import PROFILES, cases

cases()
for _name in PROFILES:
    dcp_codec.codec.get_codec(_name)
