"""Mutants of the Beaconing Protocol."""
