"""The table ``[access]`` of a PICS file: what ``run --pics FILE`` needs no options for."""

from __future__ import annotations

from pathlib import Path

import pytest
from dcp_conformance.cli.options import TARGET_SECTIONS, target_of
from dcp_conformance.errors import UsageError
from dcp_conformance.execution.target import TargetOptions

WHOLE = """
[access]
interface = "uwb0"
ether_type = 0x4953
ut = "unix:/run/node.sock"
start = "node uwb0"
stop = "node stop"
restart = "node again"
start_timeout = 60
"""


@pytest.fixture
def file(tmp_path):
    def written(text: str) -> Path:
        path = tmp_path / "pics.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return written


def test_the_file_alone_describes_the_access(file):
    options = TargetOptions(pics=file(WHOLE)).with_access()
    assert options.foreign
    assert (options.interface, options.link, options.ether_type) == ("uwb0", None, 0x4953)
    assert (options.ut, options.start, options.stop) == ("unix:/run/node.sock", "node uwb0", "node stop")
    assert (options.restart, options.start_timeout) == ("node again", 60)


def test_an_option_replaces_the_value_of_the_file(file):
    options = TargetOptions(pics=file(WHOLE), ut="tcp:localhost:9", start="other").with_access()
    assert (options.interface, options.ut, options.start) == ("uwb0", "tcp:localhost:9", "other")


@pytest.mark.parametrize("given", [{"interface": "eth1"}, {"link": "udp"}])
def test_the_link_of_the_command_line_replaces_that_of_the_file(file, given):
    options = TargetOptions(pics=file(WHOLE), **given).with_access()
    assert (options.interface, options.link) == (given.get("interface"), given.get("link"))
    assert options.ut == "unix:/run/node.sock"


def test_the_reference_node_in_this_process_needs_no_access(file):
    options = TargetOptions(pics=file(WHOLE), in_process=True)
    assert options.with_access() == options


def test_two_links_are_refused(file):
    path = file('[access]\ninterface = "a"\nlink = "udp"\n')
    with pytest.raises(UsageError, match="access: give interface or link, not both"):
        TargetOptions(pics=path).with_access()


def test_an_unusable_value_is_named(file):
    with pytest.raises(UsageError, match="ether_type"):
        TargetOptions(pics=file("[access]\nether_type = 5\n")).with_access()


def test_the_reference_node_as_a_process_needs_no_access(file):
    names = dict.fromkeys(" ".join(TARGET_SECTIONS.values()).split())
    given = {**names, "in_process": False, "timing_scale": 1.0, "seed": 1, "pics": file(WHOLE)}
    assert target_of(given).foreign
    assert not target_of({**given, "own_node": True}).foreign
