"""Subcommands of ``dcp-node`` and ``dcp-conformance`` that come with the laboratory."""
