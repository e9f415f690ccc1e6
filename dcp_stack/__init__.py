"""The reference node: BP, SRP and VarDis without input or output, its links and ``dcp-node``."""
