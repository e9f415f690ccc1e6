"""Reports of a matrix, all made from its result alone: JSON, JUnit, Markdown and one page."""

from .files import load_matrix, write_reports
from .markdown import markdown

__all__ = ["load_matrix", "markdown", "write_reports"]
