"""Messages for tests: Hypothesis strategies, seeded mutations, and the reference recordings."""
