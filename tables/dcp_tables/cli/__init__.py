"""Subcommands of ``dcp-codec`` that come with the tables."""
