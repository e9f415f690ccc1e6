"""Simulated networks: nodes on a simulated medium, in virtual time."""
