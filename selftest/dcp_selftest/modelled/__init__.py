"""Tests of the model of a node: what it finds by itself, and whom it accuses."""
