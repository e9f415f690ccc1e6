"""Test the tester: mutants that cases must detect, and permitted variants that no case may fail."""
