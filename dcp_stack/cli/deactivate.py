"""``dcp-node deactivate``."""

from .activation import activation

command = activation("Deactivate", "Deactivate BP and VarDis, or one of them; their state is kept.")
