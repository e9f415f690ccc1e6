"""Stimuli on the link: records, peers and transmission."""
