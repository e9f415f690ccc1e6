"""Networks of several implementations: network tests, two worlds that run them, and the matrix of their verdicts."""
