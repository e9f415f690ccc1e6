"""Reduce findings of the fuzzer: fewer steps, smaller frames, and the probable cause."""
