"""Test cases in which the tester plays several stations of a network."""
