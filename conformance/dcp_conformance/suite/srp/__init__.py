"""Test cases of the State Reporting Protocol."""
