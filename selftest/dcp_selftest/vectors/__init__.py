"""Behaviour vectors: making them from the cases of the suite, and what they and the wire vectors detect."""
