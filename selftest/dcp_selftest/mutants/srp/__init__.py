"""Mutants of the State Reporting Protocol."""
