"""Fuzzing: find and minimise inputs that make an implementation crash, hang, stop answering or hold a wrong state.

Generating (``dcp_lab.testing.mutation``, :mod:`dcp_lab.fuzz.generate.sequences`), executing
(:mod:`dcp_lab.fuzz.execute.live`, :mod:`dcp_lab.fuzz.execute.stack`) and minimising
(:mod:`dcp_lab.fuzz.reduce.minimise`) are independent of each other; :mod:`.campaign` connects them.
"""

from .campaign import Campaign, Limits
from .findings.artefact import Artefact, load, save
from .reduce.minimise import Minimised, Minimiser
from .steps import Call, Effect, Frame, Step, Target, Wait

__all__ = [
    "Artefact",
    "Call",
    "Campaign",
    "Effect",
    "Frame",
    "Limits",
    "Minimised",
    "Minimiser",
    "Step",
    "Target",
    "Wait",
    "load",
    "save",
]
