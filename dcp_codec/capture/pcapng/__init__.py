"""pcapng files: reader and writer."""
