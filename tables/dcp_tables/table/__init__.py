"""Columnar decoding of recordings in machine code that is generated from the layout of a profile."""
