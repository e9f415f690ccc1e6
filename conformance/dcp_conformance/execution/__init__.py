"""Execution of test cases: selection and order, single cases, whole runs, and their results."""
