"""The test cases, one module per section of the specification; the first line of a module names it."""
