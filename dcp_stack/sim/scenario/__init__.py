"""Scenario files: what they say, how they are read, and how their outcome is reported."""
