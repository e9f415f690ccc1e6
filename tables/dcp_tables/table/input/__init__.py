"""Recordings as blocks of frames for the columnar decoder."""
