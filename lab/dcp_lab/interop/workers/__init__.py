"""Several processes or machines that execute the cells of a matrix."""
