"""Frames: building them, taking received ones apart, and judging headers that cannot be decoded."""
