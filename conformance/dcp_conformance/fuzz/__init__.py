"""Fuzzing: inputs that make an implementation crash, hang, go mute or hold a wrong state, made as small as they can be.

Generating (``dcp_codec.mutation``, :mod:`.sequences`), executing (:mod:`.functions`, :mod:`.stack`, :mod:`.live`) and
minimising (:mod:`.minimise`) know nothing of each other; :mod:`.campaign` joins them.
"""

from .artefact import Artefact, load, save
from .campaign import Campaign, Limits
from .minimise import Minimised, Minimiser
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
