"""Scapy layers for DCP, made from the plan of a profile.

Only this package and :mod:`dcp_codec.network.sockets` import scapy.
"""
