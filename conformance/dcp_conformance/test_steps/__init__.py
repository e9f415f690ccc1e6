"""Test steps (ISO/IEC 9646) that several test cases share: preambles, stimuli and queries."""
