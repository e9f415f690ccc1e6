"""Positions: what safety data says about place and motion, the geometry of it, and where a node gets its own from."""
