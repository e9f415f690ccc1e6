"""Positions: access to the safety data of a profile, geometry of moving points, and sources of a node's position."""
