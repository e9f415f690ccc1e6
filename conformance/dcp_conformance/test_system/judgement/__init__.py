"""Verdicts: checks, losses of the tester, and excuses for failed checks."""
