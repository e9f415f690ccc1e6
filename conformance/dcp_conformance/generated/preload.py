"""What every trial needs beside the node, imported once: trials are forked from a process that has this module."""

import dcp_codec.codec
import dcp_conformance.case
import dcp_conformance.runner
import dcp_conformance.selection

dcp_conformance.case.all_cases()
for _name in ("dcp-2.0", "dcp-1.0"):
    dcp_codec.codec.get_codec(_name)
