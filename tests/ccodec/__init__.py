"""The generated C codec beside the Python codec: harness, comparison, campaign.

python -m tests.ccodec --frames 1000000
"""
