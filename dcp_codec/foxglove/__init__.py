"""Recordings for Foxglove: decoded channels in MCAP files, and layouts."""
