"""Execute test cases: selection, order, one case, one run, and the results of both."""
