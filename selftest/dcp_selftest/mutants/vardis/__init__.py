"""Mutants of VarDis."""
