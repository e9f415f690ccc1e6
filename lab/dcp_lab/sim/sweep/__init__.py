"""Studies: a scenario with lists of values, run for all combinations and several seeds."""
