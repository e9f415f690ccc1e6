"""Protection against formulas in CSV cells.

Descriptions and textual identifiers are received from the network, where any station can send them. A spreadsheet
evaluates a cell that begins with ``=``, ``+``, ``-`` or ``@`` as a formula. Such texts therefore get an apostrophe as
prefix, which spreadsheets read as the mark of a text. Numbers are unchanged.
"""

from __future__ import annotations

#: First characters of formulas; spreadsheets skip a tab or carriage return before them.
FORMULA_STARTS = "=+-@\t\r"
#: Non-finite numbers as JSON and CSV spell them.
_NUMBERS = frozenset({"-Infinity"})


def safe_cell(value: object) -> object:
    """Return ``value``, with an apostrophe as prefix if it is text that a spreadsheet would evaluate as a formula."""
    if isinstance(value, str) and value[:1] and value[0] in FORMULA_STARTS and value not in _NUMBERS:
        return f"'{value}"
    return value
