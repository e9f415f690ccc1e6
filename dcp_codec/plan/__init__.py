"""The plan of a profile: the construct schema as a small tree, and what code generators need of it."""
