"""``run`` and ``fuzz`` name an implementation that is absent, or whose identifier collides, before they judge it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from dcp_conformance.cli import main
from dcp_conformance.lower_tester.udp import DEFAULT_GROUP
from dcp_conformance.reference.process import free_port

from ..conformance.command import Command
from ..waiting import eventually
from .node_processes import NodeProcess

ID = "02:00:00:00:00:07"
COMMANDS = [("run", "VD-PU-07"), ("fuzz", "model"), ("fuzz", "live")]


@pytest.fixture
def command(capsys) -> Command:
    return Command(capsys, main)


@pytest.fixture
def link() -> str:
    return f"udp:{DEFAULT_GROUP}:{free_port()}"


@pytest.fixture
def nodes(tmp_path: Path, link: str) -> Iterator[list[NodeProcess]]:
    """Two nodes with one identifier, which have different variables."""
    with ExitStack() as stack:
        made = []
        for number in (1, 2):
            each = NodeProcess(tmp_path, number, "--node-id", ID, link=link)
            stack.callback(each.end)
            with each.client() as client:
                client.call("RTDB-Create", varId=number, repCnt=1, descr="x", value="55")
            made.append(each)
        yield made


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_an_absent_implementation_is_named(command, link, words):
    done = command(*words, "--link", link)
    assert done.status == 3
    if words[0] == "run":
        assert f"nothing was tested on {link}: the implementation does not take part: nothing was heard" in done.out
        assert "1 case in" in done.out
    else:
        assert "nothing was sent to it" in done.err


@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_two_nodes_with_one_identifier_are_named(command, link, nodes, words):
    del nodes
    done = command(*words, "--link", link)
    assert done.status == 2, done.out + done.err
    assert f"two nodes send as {ID} on {link}" in done.err


def test_ignored_frames_are_reported_before_the_first_case(command, link, nodes):
    with nodes[0].client() as client:
        eventually(lambda: client.call("UT-Status")["drops"].get("bp/own-beacon"), "a frame of the other node")
    nodes[1].end()
    done = command("run", "TC_DCP_SANITY_BV_01", "--link", link, "--ut", f"unix:{nodes[0].path}")
    assert done.status == 0, done.out + done.err
    assert "with its own node identifier (UT-Status): another node on the link uses the same one" in done.out + done.err
