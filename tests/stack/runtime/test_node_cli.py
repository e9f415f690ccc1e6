"""``dcp-node`` where no node is needed: help, settings, and clear words for what cannot be."""

from __future__ import annotations

import io
import logging
import socket
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import NamedTuple

import pytest
from rich.console import Console

from dcp_codec.network import interfaces
from dcp_stack.cli import main
from dcp_stack.cli.common import finish, fitted, octets_given
from dcp_stack.cli.monitor import Rates, _line, view
from dcp_stack.cli.status import _lines, as_line
from dcp_stack.drops import DROPS, ROUTINE
from dcp_stack.runtime import logs

from ..control_rig import Rig


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


def test_help_and_a_node_import_no_slow_modules():
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
        ([], "no link given; use --interface IF for Ethernet"),
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
        (["--link", "udp", "--network-id", "x"], "not a number"),
        (["--link", "udp", "--position", "moon"], "no position source 'moon'"),
        (["--link", "udp", "--position", "csv:/no/such.csv"], "/no/such.csv"),
        (["--link", "udp", "--record", "/no/such/folder/x.mcap"], "/no/such/folder/x.mcap"),
        (["--link", "udp", "--neighbour-file", "/no/such/folder/x"], "/no/such/folder/x"),
        (
            ["--link", "udp", "--control", "/no/such/folder/x.sock"],
            "/no/such/folder/x.sock: there is no folder /no/such/folder",
        ),
        (["--link", "udp", "--control", "/tmp/" + "x" * 120], "at most 107 octets"),
        (["--link", "udp", "--control", "stdio", "--position", "stdin"], "cannot both be standard input"),
        (["--link", "udp", "--user", "no-such-user"], "there is no such user"),
        (["--config", "/no/such.toml"], "/no/such.toml: cannot be read: No such file"),
        (["--metrics", "70000"], "70000"),
    ],
)
def test_invalid_configurations_are_reported_with_status_2(run, args, message):
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
    assert "exists and is not a socket" in shown.err
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
    assert "no program listens there" in shown.err
    shown = run(*args, "--control", tmp_path)
    assert shown.status == 3
    assert f"{tmp_path}: is not a socket" in shown.err


def test_without_a_path_the_usual_places_are_searched(run, tmp_path, monkeypatch):
    monkeypatch.delenv("DCP_NODE_CONTROL", raising=False)
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    monkeypatch.setattr("dcp_stack.control.places.SYSTEM", tmp_path / "system.sock")
    shown = run("status")
    assert shown.status == 3
    for place in ("dcp-node.sock", "system.sock"):
        assert f"{tmp_path}/{place}" in shown.err
    assert "start one with 'dcp-node run'" in shown.err


@pytest.mark.part("links")
def test_waiting_for_a_node_that_never_starts(run, tmp_path):
    shown = run("wait", "--timeout", "0.1", "--control", tmp_path / "none.sock")
    assert shown.status == 3
    assert "(after 0.1 s)" in shown.err


def test_wrong_usage_is_2(run, tmp_path, monkeypatch):
    monkeypatch.delenv("DCP_NODE_CONTROL", raising=False)
    assert run("nonsense").status == 2
    assert "Did you mean 'status'" in run("stauts").err
    control = ["--control", tmp_path / "none.sock"]
    assert "--value HEX or --text TEXT" in run("var", "create", "7", "--descr", "x", *control).err
    assert "--descr" in run("var", "create", "7", "--value", "00", *control).err
    assert "--value HEX or --text TEXT" in run("var", "update", "7", *control).err
    assert "is not hex" in run("var", "update", "7", "--value", "0g", *control).err
    assert run("bp", "send", "7", *control).status == 2
    assert "is not hex" in run("bp", "send", "7", "--payload", "0", *control).err
    assert "no parameter" in run("param", "set", "PERIOD", "1", *control).err
    assert "is not a number" in run("param", "set", "BPPAR_BEACON_PERIOD", "x", *control).err


@pytest.mark.parametrize(
    "args",
    [
        ("monitor", "--interval"),
        ("neighbours", "--watch", "--interval"),
        ("var", "watch", "--for"),
        ("bp", "watch", "7", "--for"),
        ("simulate", "-n", "2", "--duration"),
        ("testbed", "2", "--duration"),
    ],
)
@pytest.mark.parametrize("number", ["nan", "inf", "1e300", "-1"])
def test_durations_that_are_too_long(run, tmp_path, monkeypatch, args, number):
    monkeypatch.setenv("DCP_NODE_CONTROL", str(tmp_path / "no.sock"))
    done = run(*args, number)
    assert done.status == 2
    assert f"Invalid value for '{args[-1]}'" in done.err


@pytest.mark.parametrize(
    "args",
    [
        ("var", "create", "7", "--text", "a", "--descr", "\udcff"),
        ("bp", "register", "40", "--name", "\udcff"),
        ("param", "set", "BPPAR_BEACON_PERIOD", "nan"),
        ("param", "set", "BPPAR_BEACON_PERIOD", "1e400"),
    ],
)
def test_values_that_json_cannot_express_are_refused_before_a_request(run, tmp_path, monkeypatch, args):
    monkeypatch.setenv("DCP_NODE_CONTROL", str(tmp_path / "no.sock"))
    done = run(*args)
    assert done.status == 2
    assert "Invalid value" in done.err


def test_octets_that_are_not_utf8_are_sent_unchanged():
    assert octets_given("--value", None, "a\udcff") == "61ff"
    assert octets_given("--value", "02:AB cd", None) == "02abcd"


@pytest.mark.parametrize("name", ["\udcff", "lo" + "o" * 20, "lo\0near"])
def test_names_that_no_interface_can_have(name):
    assert not interfaces.is_up(name)
    with pytest.raises(OSError, match="No such device"):
        interfaces.mtu(name)


@pytest.mark.parametrize(
    "answer",
    [
        b"hello there",
        b"5",
        b"[]",
        b"\xff\xfe",
        b'{"jsonrpc":"2.0","id":1,"result":5}',
        b'{"jsonrpc":"2.0","id":1,"error":"no"}',
        b'{"jsonrpc":"2.0","id":null,"result":{}}',
        b'{"jsonrpc":"2.0","method":5}',
    ],
)
def test_another_server_is_distinguished_from_a_node(run, tmp_path, answer):
    path = tmp_path / "other.sock"
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        other = threading.Thread(target=answer_once, args=(listening, answer + b"\n"))
        other.start()
        done = run("status", "--control", path)
        other.join()
    assert (done.status, done.err) == (
        3,
        f"dcp-node: {path}: the program that listens there is not a node; check the path\n",
    )


def test_an_answer_without_id_belongs_to_the_pending_request(run, tmp_path):
    path = tmp_path / "other.sock"
    error = b'{"jsonrpc":"2.0","id":null,"error":{"code":-32600,"message":"the line is too long"}}\n'
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(path))
        listening.listen()
        other = threading.Thread(target=answer_once, args=(listening, error))
        other.start()
        done = run("status", "--control", path)
        other.join()
    assert (done.status, done.err) == (2, "dcp-node: the line is too long\n")


def answer_once(listening: socket.socket, answer: bytes) -> None:
    client, _ = listening.accept()
    with client:
        client.recv(1 << 16)
        client.sendall(answer)
        # Until the other side is done.
        client.recv(1)


@pytest.mark.parametrize(
    ("widths", "room", "expected"),
    [
        ([2, 17, 64, 30], 200, [2, 17, 64, 30]),
        ([2, 17, 64, 30], 79, [2, 17, 30, 30]),
        ([2, 17, 64, 30], 69, [2, 17, 25, 25]),
        ([2, 17, 64, 30], 59, [2, 17, 20, 20]),
        ([2, 17, 64, 30], 10, [2, 17, 12, 12]),
        ([2, 17, 5, 9], 10, [2, 17, 5, 9]),
    ],
)
def test_columns_are_shortened_to_fit(widths, room, expected):
    assert fitted(widths, room, (2, 3)) == expected


def test_rates_of_vanished_nodes_are_forgotten():
    rates = Rates()
    for number in range(5):
        rates.look()
        assert rates.of("sent", 10 * number, number * 10**9) == (10.0 if number else None)
        rates.of(f"from {number}", 1, number * 10**9)
    assert len(rates._before) + len(rates._now) <= 4


@pytest.mark.part("tools")
@pytest.mark.parametrize("width", [80, 160])
def test_the_monitor_shows_numbers_whole(width):
    rig = Rig()
    client = rig.client()
    client.call("RTDB-Create", varId=255, repCnt=3, descr="a description of thirty octets", value="00112233" * 8)
    rig.run(4_000_000)
    console = Console(width=width, file=io.StringIO(), highlight=False)
    status = client.call("UT-Status")
    status["runtime"] = {"uptime_ms": 1}
    console.print(view(status, Rates(), console.width))
    lines = console.file.getvalue().splitlines()
    row = next(line for line in lines if "this node" in line)
    assert row.split()[:3] == ["255", "this", "node"]
    assert ("00112233" * 8 in row) == (width == 160)
    assert max(map(len, lines)) <= width


def test_the_monitor_has_variables_in_order():
    rig = Rig()
    client = rig.client()
    for number in (200, 3, 20):
        client.call("RTDB-Create", varId=number, repCnt=3, descr="x", value="0a")
    status = client.call("UT-Status")
    status["runtime"] = {"uptime_ms": 1}
    console = Console(width=80, file=io.StringIO(), highlight=False)
    console.print(view(status, Rates(), console.width))
    rows = [line.split()[0] for line in console.file.getvalue().splitlines() if "this node" in line]
    assert rows == ["3", "20", "200"]


@pytest.mark.parametrize(("number", "title"), [(200, "200 variables"), (201, "201 variables, the first 200:")])
def test_the_monitor_indicates_hidden_rows(number, title):
    rig = Rig()
    client = rig.client()
    for each in range(number):
        client.call("RTDB-Create", varId=each, repCnt=3, descr="x", value="0a")
    status = client.call("UT-Status")
    status["runtime"] = {"uptime_ms": 1}
    console = Console(width=80, file=io.StringIO(), highlight=False)
    console.print(view(status, Rates(), console.width))
    shown = [line.strip() for line in console.file.getvalue().splitlines()]
    assert title in shown
    assert sum("this node" in line for line in shown) == 200


@pytest.mark.parametrize("width", [40, 50, 60, 70, 80])
def test_a_narrow_monitor_leaves_columns_out_instead_of_numbers(width):
    rig = Rig()
    client = rig.client()
    client.call("RTDB-Create", varId=255, repCnt=3, descr="a description of thirty octets", value="00112233" * 8)
    status = client.call("UT-Status")
    status["runtime"] = {"uptime_ms": 1}
    report = {"received_at": status["now"], "received": 12345, "position": [-1234.5, 1234.5, 123.4], "safety_data": {}}
    loss = {"heard": status["now"], "received": 12345, "lost": 1234, "loss": 0.25}
    node_id = "02:00:00:00:00:77"
    status["node"]["srp"]["neighbours"] = [{**report, "node_id": node_id}]
    status["node"]["bp"]["losses"] = [{**loss, "node_id": node_id}]
    console = Console(width=width, file=io.StringIO(), highlight=False)
    console.print(view(status, Rates(), console.width))
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    (neighbour,) = (line.split() for line in lines if node_id in line)
    assert neighbour[0] == node_id
    assert "25 %" in " ".join(neighbour)
    (variable,) = (line.split() for line in lines if "this node" in line)
    assert variable[:3] == ["255", "this", "node"]
    assert any(each.startswith("00112233") for each in variable)


def test_names_of_others_reach_no_terminal_unescaped(capsys):
    name = "a\x9b31m\u202eb\u00e9"
    finish("RTDB-DescribeDatabase", {"status": "VARDIS-STATUS-OK", "variables": [{"descr": name}]}, True)
    print(as_line({"node": name}))
    stream = io.StringIO()
    logs.set_up("info", "text", stream)
    logging.getLogger("test").info("heard %s", name)
    lines = (capsys.readouterr().out + stream.getvalue()).splitlines()
    assert len(lines) == 3
    assert all(line.isprintable() for line in lines)


def test_repetitions_are_not_shown_as_ignored():
    drops = {"bp/foreign-network": 2, "vardis/summary-equal": 34, "vardis/summary-own": 31}
    status = Rig().client().call("UT-Status") | {"runtime": {"uptime_ms": 1}, "drops": drops}
    assert _lines(status)[-2:] == [
        "ignored    bp/foreign-network 2",
        "redundant  vardis/summary-equal 34, vardis/summary-own 31",
    ]
    assert " ignored=2 redundant=65" in _line(status, Rates())
    console = Console(width=80, file=io.StringIO(), highlight=False)
    console.print(view(status, Rates(), 80))
    assert [line.rstrip() for line in console.file.getvalue().splitlines()][-2:] == _lines(status)[-2:]
    assert {f"vardis/{reason}" for reason in DROPS} >= ROUTINE
