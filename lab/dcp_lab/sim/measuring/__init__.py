"""Measurements of a simulation: delay and reception of each value, and the share of nodes with the newest values."""
