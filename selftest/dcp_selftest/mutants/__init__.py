"""Mutants: our node with one small fault each, used to test that the suite detects faults."""

from .mutant import ALL_MUTANTS, Mutant, all_mutants, mutant, mutants_of, node_with

__all__ = ["ALL_MUTANTS", "Mutant", "all_mutants", "mutant", "mutants_of", "node_with"]
