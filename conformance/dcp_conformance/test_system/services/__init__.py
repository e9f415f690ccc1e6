"""Calls of services through the upper tester, and the changes that they make."""
