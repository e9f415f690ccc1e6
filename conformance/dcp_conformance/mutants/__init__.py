"""Our node with small faults in it, one in each mutant: what the suite must notice, or it is worth nothing."""

from .mutant import Mutant, all_mutants, mutant, mutants_of, node_with

__all__ = ["Mutant", "all_mutants", "mutant", "mutants_of", "node_with"]
