"""The wire formats of a profile as construct schemas."""
