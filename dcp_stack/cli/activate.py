"""``dcp-node activate``."""

from .activation import activation

command = activation("Activate", "Let BP and VarDis (or one of them) send, receive and serve.")
