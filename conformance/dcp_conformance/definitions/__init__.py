"""The data model of the suite: test cases, verdicts, results, PICS and PIXIT. No input or output but files of these."""
