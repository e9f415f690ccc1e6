"""CSV cells that spreadsheets take for formulas.

Descriptions and textual identifiers come from the air, where anybody can send them. A spreadsheet runs a cell that
begins with ``=``, ``+``, ``-`` or ``@`` as a formula, so such texts get an apostrophe in front, which spreadsheets take
for "this is text". Numbers stay numbers.
"""

from __future__ import annotations

#: First characters of formulas; tab and carriage return are skipped by spreadsheets.
FORMULA_STARTS = "=+-@\t\r"
#: What JSON and CSV write for numbers that they have no digits for.
_NUMBERS = frozenset({"-Infinity"})


def safe_cell(value: object) -> object:
    """``value`` itself, or with an apostrophe in front if it is text that a spreadsheet would take for a formula."""
    if isinstance(value, str) and value[:1] and value[0] in FORMULA_STARTS and value not in _NUMBERS:
        return f"'{value}"
    return value
