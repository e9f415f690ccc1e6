"""Testbeds: networks of node processes in network namespaces, in real time."""
