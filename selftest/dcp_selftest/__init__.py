"""Tests of the test suite: mutants that cases must detect, and permitted variants that no case may fail."""
