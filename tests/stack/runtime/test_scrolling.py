"""The part of a long view that is shown, and the note about the rest."""

from __future__ import annotations

import os
import pty
import threading

import pytest
from rich.console import Console
from rich.text import Text

from dcp_stack.cli.scrolling import Window, key_within


def drawn(window: Window, lines: int, height: int = 10) -> list[str]:
    console = Console(width=60, height=height, force_terminal=False)
    with console.capture() as captured:
        console.print(window.shown(Text("\n".join(f"line {number}" for number in range(lines)))))
    return captured.get().splitlines()


def test_a_short_view_is_whole():
    assert drawn(Window(), 10) == [f"line {number}" for number in range(10)]


def test_a_long_view_states_the_number_of_hidden_lines():
    window = Window()
    shown = drawn(window, 31)
    assert shown[:9] == [f"line {number}" for number in range(9)]
    assert shown[9].startswith("0 lines above, 22 below: arrows")
    assert len(shown) == 10


@pytest.mark.parametrize(
    ("keys", "first"),
    [
        (["down"], 1),
        (["up"], 0),
        (["page down"], 8),
        (["page down", "page up"], 0),
        (["end"], 22),
        (["end", "down"], 22),
        (["end", "top"], 0),
    ],
)
def test_keys_scroll_the_view(keys, first):
    window = Window()
    drawn(window, 31)
    for key in keys:
        window.move(key)
    shown = drawn(window, 31)
    assert shown[0] == f"line {first}"
    assert f"{first} lines above, {22 - first} below" in shown[9]


def test_the_position_stays_valid_when_the_view_becomes_shorter():
    window = Window()
    drawn(window, 31)
    window.move("end")
    assert drawn(window, 12)[0] == "line 3"
    assert drawn(window, 5) == [f"line {number}" for number in range(5)]


def test_keys_of_a_terminal():
    master, slave = pty.openpty()
    try:
        import tty

        tty.setcbreak(slave)
        threading.Timer(0.05, os.write, (master, b"x")).start()
        threading.Timer(0.1, os.write, (master, b"\x1b[6~")).start()
        assert key_within(slave, 5) == "page down"
        assert key_within(slave, 0.01) is None
    finally:
        os.close(master)
        os.close(slave)
