"""Scenario files: their content, how they are loaded, and the report of a run."""
