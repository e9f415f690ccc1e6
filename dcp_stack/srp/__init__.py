"""The State Reporting Protocol (dcp-srp.md) without input or output."""
