"""Scrolling of a view that is longer than the terminal, and its keys."""

from __future__ import annotations

import contextlib
import os
import select
import sys
import termios
import time
import tty
from collections.abc import Iterator
from typing import Final

from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.segment import Segment
from rich.text import Text

#: Octets that terminals send -> action.
KEYS: Final = {
    b"\x1b[A": "up",
    b"\x1bOA": "up",
    b"k": "up",
    b"\x1b[B": "down",
    b"\x1bOB": "down",
    b"j": "down",
    b"\x1b[5~": "page up",
    b"b": "page up",
    b"\x1b[6~": "page down",
    b" ": "page down",
    b"\x1b[H": "top",
    b"\x1b[1~": "top",
    b"g": "top",
    b"\x1b[F": "end",
    b"\x1b[4~": "end",
    b"G": "end",
    b"q": "quit",
}


class Window:
    """The visible part of a view, with a last line about the hidden parts."""

    def __init__(self) -> None:
        self.top = 0
        """The first line shown, from 0."""
        self._total = self._room = 0

    def move(self, key: str) -> None:
        """Scroll according to an action of :data:`KEYS`."""
        page = max(self._room - 1, 1)
        steps = {"up": -1, "down": 1, "page up": -page, "page down": page, "top": -self.top, "end": self._total}
        self.top += steps.get(key, 0)
        self._stay_inside()

    def shown(self, view: RenderableType) -> Part:
        """Return the part of ``view`` to draw now."""
        return Part(self, view)

    def fit(self, total: int, height: int) -> tuple[int, int]:
        """Store the lengths of view and terminal in lines; return the first and the end line to draw."""
        self._total = total
        self._room = height if total <= height else height - 1
        self._stay_inside()
        return self.top, min(self.top + self._room, total)

    def _stay_inside(self) -> None:
        self.top = max(min(self.top, self._total - self._room), 0)


class Part:
    """The renderable that draws the visible part."""

    def __init__(self, window: Window, view: RenderableType) -> None:
        self._window = window
        self._view = view

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        height = options.height or console.height
        lines = console.render_lines(self._view, options.update(height=None), pad=False)
        begin, end = self._window.fit(len(lines), height)
        for line in lines[begin:end]:
            yield from line
            yield Segment.line()
        if end - begin < len(lines):
            hidden = f"{begin} lines above, {len(lines) - end} below"
            yield Text(
                f"{hidden}: arrows, Page Up and Down, q ends", style="reverse", no_wrap=True, overflow="ellipsis"
            )


@contextlib.contextmanager
def keyboard() -> Iterator[int | None]:
    """Yield standard input, set to read single keys without echo; None if it is not a terminal."""
    if not sys.stdin.isatty():
        yield None
        return
    fd = sys.stdin.fileno()
    before = termios.tcgetattr(fd)
    try:
        tty.setcbreak(fd)
        yield fd
    finally:
        termios.tcsetattr(fd, termios.TCSADRAIN, before)


def key_within(fd: int | None, seconds: float) -> str | None:
    """Return the action of the next known key within ``seconds`` s; None if none is pressed."""
    deadline = time.monotonic() + seconds
    while (left := deadline - time.monotonic()) > 0:
        if fd is None:
            time.sleep(left)
            return None
        ready, _, _ = select.select([fd], [], [], left)
        if ready and (key := KEYS.get(os.read(fd, 16))):
            return key
    return None
