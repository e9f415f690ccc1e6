"""Experiments with many nodes and many inputs: simulator, testbed, explorer, networks of implementations, fuzzer."""
