"""Our own node as the implementation under test: with the mutants, the only part that may import it."""
