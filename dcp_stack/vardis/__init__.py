"""The core of VarDis, the Variable Dissemination Protocol (dcp-vardis.md), without input or output."""
