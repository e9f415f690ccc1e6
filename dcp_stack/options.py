"""Options in texts that name a link or a position source: ``udp:239.1.1.1,ttl=2``, ``csv:FILE,speed=2``."""

from __future__ import annotations

import math
from collections.abc import Collection


class Options:
    """The parts ``key=value`` of a text, separated by commas, after the first part. Each key may occur once."""

    def __init__(self, text: str, known: Collection[str], *, of_a_file: bool = False) -> None:
        """Split ``text`` into :attr:`head`, its first part, and options.

        With ``of_a_file`` the first part is a path, which may contain commas: the options are the parts at the end
        whose keys are known. Raises ValueError for an unknown or repeated key, and for a part without "=".
        """
        parts = text.split(",")
        first = 1
        if of_a_file:
            first = len(parts)
            while first > 1 and "=" in parts[first - 1] and parts[first - 1].partition("=")[0].strip() in known:
                first -= 1
        self.head = ",".join(parts[:first])
        self._values: dict[str, str] = {}
        for part in parts[first:]:
            key, equals, value = (each.strip() for each in part.partition("="))
            if not equals:
                raise ValueError(f"{part!r} is not of the form key=value")
            if key not in known:
                raise ValueError(f"no option {key!r}; known options are {', '.join(sorted(known))}")
            if key in self._values:
                raise ValueError(f"{key} is given twice")
            self._values[key] = value

    def text(self, key: str) -> str | None:
        """Return the value of an option, None if it is not given."""
        return self._values.get(key)

    def number(self, key: str, default: float) -> float:
        """Return an option as a finite number. Raises ValueError for any other text."""
        text = self._values.get(key)
        if text is None:
            return default
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise ValueError(f"{key} takes a number, not {text!r}")
        return value

    def integer(self, key: str, low: int, high: int) -> int | None:
        """Return an option as an integer within bounds, None if it is not given. Raises ValueError."""
        text = self._values.get(key)
        if text is None:
            return None
        if not text.isdecimal() or not low <= int(text) <= high:
            raise ValueError(f"{key} takes an integer from {low} to {high}, not {text!r}")
        return int(text)

    def flag(self, key: str, *, default: bool) -> bool:
        """Return an option as yes or no. Raises ValueError for any other text."""
        text = self._values.get(key)
        if text is None:
            return default
        if text.lower() not in ("yes", "no", "1", "0", "true", "false"):
            raise ValueError(f"{key} takes yes or no, not {text!r}")
        return text.lower() in ("yes", "1", "true")
