"""All code that imports scapy: layers for DCP made from the plan of a profile, and packet sockets for Ethernet.

No other package imports scapy, which is licensed GPL-2.0-only. Without the extra ``scapy`` this package is not loaded.
"""
