"""Classic pcap files: reader and writer."""
