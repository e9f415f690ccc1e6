"""Generate fuzz tests: damaged messages, sequences of steps, and the coverage that guides them."""
