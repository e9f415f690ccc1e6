"""Test cases of BP: contents, times and reception of beacons."""
