"""The colours of pages in the light and dark schemes, and symbols that are equivalent to the colours of series.

Text and lines have a contrast of at least 4.5 to 1 with their background in both schemes.
"""

from __future__ import annotations

#: Light and dark colour by role. Roles are CSS variables of the page. The plots have the light colours, and the script
#: of the page replaces them in the dark scheme.
SCHEMES: dict[str, tuple[str, str]] = {
    "paper": ("#fbfbfa", "#14171a"),
    "card": ("#ffffff", "#1c2024"),
    "ink": ("#1c1f23", "#e3e6e9"),
    "soft": ("#57606a", "#a3adb8"),
    "line": ("#dfe2e6", "#333a41"),
    "code": ("#f3f4f5", "#23282e"),
    "fail": ("#c0272d", "#ff7b73"),
    "good": ("#a9c8e8", "#2f5478"),
    "way": ("#7fa8d3", "#41729f"),
    "bad": ("#ffd9d6", "#5a2220"),
    "bad-ink": ("#8c1414", "#ffc9c4"),
    "accent": ("#2b5fa9", "#8fb8f0"),
    "s0": ("#1f6cae", "#62aee8"),
    "s1": ("#b84a06", "#ff9a52"),
    "s2": ("#18773f", "#4cc27e"),
    "s3": ("#9333a8", "#d58ae6"),
    "s4": ("#8a6400", "#e5ae45"),
    "s5": ("#0b7676", "#4fcaca"),
    "s6": ("#bb2c74", "#f27db5"),
    "s7": ("#5f50c4", "#a89cf5"),
    "s8": ("#7a4b21", "#cc9a6e"),
    "s9": ("#5a6c00", "#b5cc4d"),
}

#: Marker of Bokeh and the equivalent character of each series, in the order of colours.
SYMBOLS = (
    ("circle", "●"), ("square", "■"), ("triangle", "▲"), ("diamond", "◆"), ("inverted_triangle", "▼"),
    ("plus", "✚"), ("star", "★"), ("hex", "⬢"), ("x", "✖"), ("asterisk", "✱"),
)  # fmt: skip
#: Dashes of lines: of the first ten series, and of the next ten.
DASHES = ("solid", "dashed")


def light(role: str) -> str:
    """Return the colour of a role in the light scheme."""
    return SCHEMES[role][0]


def series_colour(number: int) -> str:
    """Return the colour of a series in the light scheme; colours repeat after ten series."""
    return light(f"s{number % 10}")
