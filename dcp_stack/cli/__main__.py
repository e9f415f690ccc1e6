"""Run ``dcp-node`` as ``python -m dcp_stack.cli``."""

from . import main

main()
