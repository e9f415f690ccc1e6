"""Write one report for each probable fault of a run, for the issue tracker of the implementation."""

from .write import write_issues

__all__ = ["write_issues"]
