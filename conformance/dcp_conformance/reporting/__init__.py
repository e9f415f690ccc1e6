"""Reports: everything here is made from results as data, of one run or of several."""

from .files import load_results, make_folder, write_report

__all__ = ["load_results", "make_folder", "write_report"]
