"""The rules of ``dcp-conformance check``, one module for each subject."""
