"""Reports made from the results of one or several runs: HTML, JSON, JUnit, CSV, Markdown, recordings.

Every report is made from :class:`~dcp_conformance.definitions.results.RunResult` alone, so it can be made again from
``results.json``.
"""

from .files import load_results, make_folder, write_report

__all__ = ["load_results", "make_folder", "write_report"]
