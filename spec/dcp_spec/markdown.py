"""Tables in Markdown."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

#: A padded last column that is wider than this is not padded.
_WIDEST = 60


def table(columns: Sequence[str], rows: Iterable[Sequence[object]], align: str = "", *, padded: bool = False) -> str:
    """Return a table without a line end after its last row.

    Cells may hold Markdown; each is put on one line, and its ``|`` are escaped unless they are already. ``align`` has
    ``l`` or ``r`` for each column; the others are aligned to the left. ``padded``: the columns are as wide as their
    cells, for a reader of the text.
    """
    cells = [[_cell(each) for each in row] for row in (columns, *rows)]
    widths = [max(len(row[place]) if padded else 0 for row in cells) for place in range(len(columns))]
    if widths[-1] > _WIDEST:
        widths[-1] = len(cells[0][-1])
    head, *body = [f"| {' | '.join(map(str.ljust, row, widths))} |" for row in cells]
    marks = zip(widths, align.ljust(len(columns)), strict=True)
    rule = "|".join("-" * max(width + 2, 3) + ":" * (place == "r") for width, place in marks)
    return "\n".join([head, f"|{rule}|", *body])


def _cell(value: object) -> str:
    return re.sub(r"(?<!\\)\|", r"\|", str(value)).replace("\n", " ")
