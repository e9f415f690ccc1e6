"""Frames: build them, decode received ones, and judge headers that cannot be decoded."""
