"""Fuzzing our own code in this process: the reference node, its mutants, and functions."""
