"""``dcp-node`` where no node is needed: help, settings, and clear words for what cannot be."""

from __future__ import annotations

import logging
import socket
import subprocess
import sys
from collections.abc import Callable
from typing import NamedTuple

import pytest

from dcp_stack.cli import main


class Result(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture(autouse=True)
def log():
    """The log is the process's own, and in tests it is that of pytest."""
    root = logging.getLogger()
    before = root.handlers[:], root.level, logging.raiseExceptions
    yield
    root.handlers[:], level, logging.raiseExceptions = before
    root.setLevel(level)


@pytest.fixture
def run(capsys) -> Callable[..., Result]:
    def call(*args: object) -> Result:
        capsys.readouterr()
        with pytest.raises(SystemExit) as stop:
            main([str(arg) for arg in args])
        captured = capsys.readouterr()
        assert "Traceback" not in captured.err
        return Result(int(stop.value.code or 0), captured.out, captured.err)

    return call


def test_help_names_the_commands_and_the_exit_statuses(run):
    shown = run("--help")
    assert shown.status == 0
    for name in ("run", "status", "monitor", "neighbours", "var", "bp", "param", "activate", "deactivate", "reset"):
        assert f"  {name} " in shown.out
    assert "3 no node could be reached" in " ".join(shown.out.split())
    assert run("run", "--help").status == 0
    assert run("var", "create", "--help").status == 0
    assert "create" in run("var", "--help").out
    assert run("--version").out.startswith("dcp-node")


def test_help_and_a_node_do_without_what_is_slow_to_load():
    code = (
        "import sys\n"
        "from dcp_stack.cli import main\n"
        "import dcp_stack.cli.run, dcp_stack.runtime.opening\n"
        "slow = {'asyncio', 'rich', 'scapy', 'mcap', 'yaml', 'http.server', 'prometheus_client'} & set(sys.modules)\n"
        "print(*slow)\n"
    )
    shown = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    # The recorder is at hand for --record; its library comes with dcp_codec.capture.
    assert set(shown) <= {"mcap"}


def test_print_config(run, tmp_path):
    shown = run("run", "--link", "udp", "--beacon-period", "50", "--network-id", "0x2222", "--print-config")
    assert shown.status == 0
    assert 'link = "udp"' in shown.out
    path = tmp_path / "node.toml"
    path.write_text(shown.out)
    assert run("run", "--config", path, "--print-config").out == shown.out
    assert "beacon_period_ms = 50\n" in shown.out
    assert "network_id = 8738\n" in shown.out


@pytest.mark.parametrize(
    ("args", "message"),
    [
        ([], "which link? --interface IF for Ethernet"),
        (["--link", "carrier-pigeon"], "is not a link"),
        (["--link", "udp:239.73.126.1:99999"], "port"),
        (["--link", "udp:10.0.0.300"], "not an IPv4 address"),
        (["--link", "udp,interface=203.0.113.7"], "no interface has the address 203.0.113.7"),
        (["--interface", "nonesuch0"], "there is no such interface; there are"),
        (["--link", "replay:/no/such/file.mcap"], "/no/such/file.mcap"),
        (["--link", "udp", "--profile", "dcp-9.9"], "dcp-9.9"),
        (["--link", "udp", "--node-id", "02"], "node_id: 02 has 1 octets"),
        (["--link", "udp", "--beacon-period", "0"], "BPPAR_BEACON_PERIOD must be greater than 0"),
        (["--link", "udp", "--beacon-period", "0.5"], "bp.beacon_period_ms: expected int, got float"),
        (["--link", "udp", "--network-id", "65536"], "BPPAR_NETWORK_ID must be at most 65535"),
        (["--link", "udp", "--network-id", "x"], "no number"),
        (["--link", "udp", "--position", "moon"], "no position source 'moon'"),
        (["--link", "udp", "--position", "csv:/no/such.csv"], "/no/such.csv"),
        (["--link", "udp", "--record", "/no/such/folder/x.mcap"], "/no/such/folder/x.mcap"),
        (["--link", "udp", "--neighbour-file", "/no/such/folder/x"], "/no/such/folder/x"),
        (["--link", "udp", "--control", "/no/such/folder/x.sock"], "/no/such/folder/x.sock: No such file"),
        (["--link", "udp", "--control", "/tmp/" + "x" * 120], "at most 107 octets"),
        (["--link", "udp", "--control", "stdio", "--position", "stdin"], "cannot both be standard input"),
        (["--link", "udp", "--user", "no-such-user"], "there is no such user"),
        (["--config", "/no/such.toml"], "/no/such.toml: No such file"),
        (["--metrics", "70000"], "70000"),
    ],
)
def test_what_cannot_run_says_so_and_ends_with_2(run, args, message):
    shown = run("run", *args)
    assert shown.status == 2
    assert message in shown.err
    assert shown.out == ""


def test_beacons_that_the_link_cannot_carry(run, tmp_path):
    path = tmp_path / "node.toml"
    path.write_text('link = "udp,size=600"\n[bp]\nmax_packet_size = 900\n')
    shown = run("run", "--config", path)
    assert shown.status == 2
    assert "carries at most 600 octets, not 900" in shown.err


def test_control_sockets_that_are_in_use_or_none(run, tmp_path):
    path = tmp_path / "node.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(path))
        listener.listen()
        shown = run("run", "--link", "udp", "--control", path)
        assert shown.status == 2
        assert "another node listens there" in shown.err
    path.unlink()
    path.write_text("precious")
    shown = run("run", "--link", "udp", "--control", path)
    assert shown.status == 2
    assert "exists and is no socket" in shown.err
    assert path.read_text() == "precious"


def test_a_metrics_port_in_use(run):
    pytest.importorskip("prometheus_client")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        shown = run("run", "--link", "udp", "--metrics", taken.getsockname()[1])
    assert shown.status == 2
    assert "the port is in use" in shown.err


@pytest.mark.parametrize(
    "args",
    [
        ["status"],
        ["monitor", "--count", "1"],
        ["neighbours"],
        ["var", "list"],
        ["var", "get", "7"],
        ["bp", "list"],
        ["param", "get"],
        ["reset"],
        ["activate"],
        ["deactivate", "bp"],
    ],
)
def test_no_node_is_3(run, args, tmp_path):
    shown = run(*args, "--control", tmp_path / "none.sock")
    assert shown.status == 3
    assert "is a node running" in shown.err
    stale = tmp_path / "stale.sock"
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(stale))
    shown = run(*args, "--control", stale)
    assert shown.status == 3
    assert "nobody listens there" in shown.err


def test_wrong_usage_is_2(run, tmp_path, monkeypatch):
    monkeypatch.delenv("DCP_NODE_CONTROL", raising=False)
    assert run("status").status == 2
    assert run("nonsense").status == 2
    control = ["--control", tmp_path / "none.sock"]
    assert "--value HEX or --text TEXT" in run("var", "create", "7", "--descr", "x", *control).err
    assert "--descr" in run("var", "create", "7", "--value", "00", *control).err
    assert "--value HEX or --text TEXT" in run("var", "update", "7", *control).err
    assert "is not hex" in run("var", "update", "7", "--value", "0g", *control).err
    assert run("bp", "send", "7", *control).status == 2
    assert "is not hex" in run("bp", "send", "7", "--payload", "0", *control).err
    assert "no parameter" in run("param", "set", "PERIOD", "1", *control).err
    assert "is no number" in run("param", "set", "BPPAR_BEACON_PERIOD", "x", *control).err
