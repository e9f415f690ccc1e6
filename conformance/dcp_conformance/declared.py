"""Requirements that a profile declares as not met: what an implementation of that profile passes is something else.

A profile describes the octets of an implementation, also where they are not those of the specification. Cases test
against the profile; that they pass does not show the sentence of the specification. ``TC_DCP_PROF_BV_01`` fails for
them in a run; elsewhere (in a recording, in a run of other cases) a pass of such a requirement becomes an information.
"""

from __future__ import annotations

from collections.abc import Mapping

from dcp_spec.deviations import deviations as declared_by

from .verdict import Verdict

__all__ = ["declared_by", "without_declared"]


def without_declared(verdicts: Mapping[str, Verdict], declared: Mapping[str, str]) -> dict[str, Verdict]:
    """The verdicts, with no pass for a requirement that the profile declares as not met."""
    return {
        name: Verdict.INFO if verdict is Verdict.PASS and name in declared else verdict
        for name, verdict in verdicts.items()
    }
