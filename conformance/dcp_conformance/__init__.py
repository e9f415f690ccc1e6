"""The conformance suite: cases, oracle, frame builder and ``dcp-conformance``."""
