"""Tables in Markdown."""

from __future__ import annotations

from dcp_spec.markdown import table


def test_cells_stay_in_their_table():
    assert table(("a", "b"), [("x|y", "one\ntwo"), ("x\\|y", 3)], "lr") == (
        "| a | b |\n|---|---:|\n| x\\|y | one two |\n| x\\|y | 3 |"
    )


def test_padded_columns():
    text = table(("a", "b", "c"), [("long", "", "x" * 61), ("s", "1", "")], padded=True)
    assert text.splitlines() == [
        "| a    | b | c |",
        "|------|---|---|",
        f"| long |   | {'x' * 61} |",
        "| s    | 1 |   |",
    ]
