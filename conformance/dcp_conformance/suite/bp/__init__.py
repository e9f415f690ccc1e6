"""Test cases of the Beaconing Protocol."""
