"""The plan of a profile: the construct schema as a small tree, and helpers for code generators."""
