"""A node at work: sockets, clocks, files and signals around the cores."""
