"""Frames and notifications from the implementation, and waiting for them."""
