"""The running node: sockets, clocks, files and signals around the protocol entities."""
