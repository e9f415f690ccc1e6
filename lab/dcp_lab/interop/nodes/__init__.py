"""The nodes of a network test: real processes on links of their own, or nodes in virtual time."""
