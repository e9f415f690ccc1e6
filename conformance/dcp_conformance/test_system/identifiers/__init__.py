"""Identifiers of nodes and variables that the implementation does not know."""
