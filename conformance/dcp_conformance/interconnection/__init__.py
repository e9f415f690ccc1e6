"""Start a run: the basic interconnection test (ISO/IEC 9646), and disagreements of implementation and tester."""
