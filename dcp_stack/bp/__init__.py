"""The Beaconing Protocol (dcp-bp.md) without input or output."""
