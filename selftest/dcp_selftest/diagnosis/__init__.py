"""Make the fault dictionary with the mutants, and measure the diagnosis that uses it."""
