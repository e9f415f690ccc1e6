"""``dcp-node activate``."""

from .activation import activation

command = activation("Activate", "Activate BP and VarDis, or one of them.")
