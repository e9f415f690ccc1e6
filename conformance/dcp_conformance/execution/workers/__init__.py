"""Several processes that share the cases of a run, with and without pytest."""
