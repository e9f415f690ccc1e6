"""Make and measure the fault dictionary with the mutants."""
