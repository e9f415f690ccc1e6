"""``python -m dcp_stack.cli`` is ``dcp-node``."""

from . import main

main()
