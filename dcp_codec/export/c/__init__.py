"""Codec in C99 for one profile: one header and one source, without allocation, for hosted and freestanding programs.

The decoder has the verdicts, reasons, offsets and requirements of ``dcp_codec.views.decoder``; the shape of a beacon
(:mod:`dcp_codec.export.shape`) decides which functions there are.
"""
