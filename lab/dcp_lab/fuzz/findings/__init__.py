"""Findings of the fuzzer as files: written, described, replayed, and used as test cases."""
