"""``dcp-node deactivate``."""

from .activation import activation

command = activation("Deactivate", "Let BP and VarDis (or one of them) rest; what they know is kept.")
