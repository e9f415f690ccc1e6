"""Detect whether the implementation still runs and answers, and find the case that ended it."""
