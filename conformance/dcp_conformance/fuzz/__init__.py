"""Fuzzing: inputs that make an implementation crash, hang, go mute or hold a wrong state, made as small as they can be.

Generating (``dcp_codec.testing.mutation``, :mod:`dcp_conformance.fuzz.generate.sequences`), executing
(:mod:`dcp_conformance.fuzz.execute.functions`, :mod:`dcp_conformance.fuzz.execute.stack`,
:mod:`dcp_conformance.fuzz.execute.live`) and
minimising (:mod:`dcp_conformance.fuzz.reduce.minimise`) know nothing of each other; :mod:`.campaign` joins them.
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
