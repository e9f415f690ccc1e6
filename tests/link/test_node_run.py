"""``dcp-node run`` and the commands that talk to it, as people use them: processes on the loopback interface."""

from __future__ import annotations

import json
import os
import signal
import socket
import stat
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from dcp_codec import Codec
from dcp_codec.capture import open_capture
from dcp_stack.control.client import ControlClient, ControlError
from dcp_stack.links.udp import open_udp
from dcp_stack.neighbour_file import NeighbourFileReader

from ..ports import own_port
from ..waiting import PATIENCE, eventually
from .node_processes import LINK, NodeProcess, command, keeps_rate, lines, slots_a_second

GROUP, PORT = LINK.split(":")[1], int(LINK.split(":")[2])


@pytest.fixture
def node(tmp_path) -> Iterator[Callable[..., NodeProcess]]:
    """Starts nodes, and ends them afterwards."""
    started: list[NodeProcess] = []

    def start(*args: str, **options) -> NodeProcess:
        started.append(NodeProcess(tmp_path, len(started) + 1, *args, **options))
        return started[-1]

    yield start
    for each in started:
        each.end()


def raw(path) -> socket.socket:
    client = socket.socket(socket.AF_UNIX)
    # Blocking, or a crowd would be turned away by the system already.
    client.connect(str(path))
    client.settimeout(PATIENCE)
    return client


def answers(client: socket.socket, count: int) -> list[dict]:
    with client.makefile("rb") as stream:
        return [json.loads(stream.readline()) for _ in range(count)]


HELLO = b'{"jsonrpc":"2.0","id":1,"method":"UT-Hello"}\n'


def patient(folder: Path) -> tuple[str, str]:
    """Options of a node that does not forget a neighbour whom the machine keeps waiting."""
    path = folder / "patient.toml"
    path.write_text("[srp]\nneighbour_table_timeout_ms = 600000\n")
    return "--config", str(path)


def test_nodes_with_the_settings_of_the_installation_hear_each_other(node, tmp_path):
    """The settings as documented, but for the interface, and for names that exist only on a drone."""
    text = (Path(__file__).parents[2] / "docs" / "installation.md").read_text().partition("```toml\n")[2]
    text = text.partition("```")[0].replace('"dcp"', f'"{os.getgid()}"').replace("/var/lib/dcp/", f"{tmp_path}/")
    config = tmp_path / "node.toml"
    config.write_text(f"{text}[srp]\nneighbour_table_timeout_ms = 600000\n")
    started = [node("--config", str(config)) for _ in range(2)]
    for each, other in zip(started, reversed(started), strict=True):
        with each.client() as client:
            eventually(lambda client=client: client.call("SRP-NeighbourTable")["neighbours"], "it hears the other")
        assert other.node_id in command("neighbours", "--control", each.path).stdout


def test_two_nodes_and_the_commands(node, tmp_path):
    second = node(*patient(tmp_path))
    first = node("--position", "track:circle,radius=5")
    for each in (first, second):
        each.client().close()
    shown = command("var", "create", 7, "--text", "85 %", "--descr", "battery", "--control", first.path)
    assert (shown.returncode, shown.stdout) == (0, "VARDIS-STATUS-OK\n")
    again = command(
        "var", "create", 8, "--value", "00", "--descr", "x", "--repcnt", 99, "--control", first.path, "--json"
    )
    assert (again.returncode, json.loads(again.stdout)) == (1, {"status": "VARDIS-STATUS-ILLEGAL-REPCOUNT"})
    with second.client() as client:
        eventually(lambda: client.call("RTDB-Read", varId=7)["status"].endswith("-OK"), "the variable arrives")
        eventually(lambda: client.call("SRP-NeighbourTable")["neighbours"], "the neighbour is seen")
    control = ("--control", second.path)
    assert command("var", "get", 7, "--text", *control).stdout == "85 %\n"
    refused = command("var", "update", 7, "--value", "00", *control)
    assert refused.returncode == 1
    assert "VARDIS-STATUS-NOT-PRODUCER: The variable has another producer" in refused.stderr
    listed = command("var", "list", *control).stdout
    assert "battery" in listed
    assert '38352025 "85 %"' in listed
    (entry,) = json.loads(command("var", "list", "--json", *control).stdout)["variables"]
    assert entry["prodId"] == first.node_id
    assert "descr" in command("var", "describe", 7, *control).stdout
    assert first.node_id in command("neighbours", *control).stdout
    tables = lines(command("neighbours", "--watch", "--count", 2, "--interval", 0.1, "--json", *control).stdout)
    assert [len(each["neighbours"]) for each in tables] == [1, 1]
    status = command("status", *control).stdout
    assert second.node_id in status
    assert "1 neighbour of at most 4096\n" in status
    looks = command("monitor", "--count", 2, "--interval", 0.2, *control).stdout.splitlines()
    assert len(looks) == 2
    assert "neighbours=1 variables=1" in looks[1]
    assert "received/s=" in looks[1]
    assert "VarDis -- Variable Dissemination Protocol V2.0" in command("bp", "list", *control).stdout
    assert "BPPAR_BEACON_PERIOD" in command("param", "get", *control).stdout
    assert command("param", "set", "BPPAR_BEACON_PERIOD", 60, *control).stdout == "BP-STATUS-OK\n"
    assert command("param", "get", "BPPAR_BEACON_PERIOD", *control).stdout == "60\n"
    refused = command("param", "set", "BPPAR_BEACON_PERIOD", 0, *control)
    assert (refused.returncode, refused.stdout) == (1, "")
    assert "must be greater than 0" in refused.stderr
    assert command("deactivate", *control).stdout == "BP-STATUS-OK\nVARDIS-STATUS-OK\n"
    refused = command("var", "get", 7, *control)
    assert refused.returncode == 1
    assert "INACTIVE" in refused.stderr
    assert command("activate", "vardis", *control).stdout == "VARDIS-STATUS-OK\n"
    assert json.loads(command("activate", "--json", *control).stdout).keys() == {"BP-MGMT-Activate", "VD-MGMT-Activate"}
    assert command("reset", *control).stdout == "UT-STATUS-OK\n"
    assert command("param", "get", "BPPAR_BEACON_PERIOD", *control).stdout == "100\n"
    assert command("var", "delete", 7, "--control", first.path).stdout == "VARDIS-STATUS-OK\n"


def test_activation_applies_to_protocols_that_the_node_runs(node, tmp_path):
    config = tmp_path / "without.toml"
    config.write_text("[vardis]\nenabled = false\n")
    without = node("--config", str(config))
    without.client().close()
    for verb in ("deactivate", "activate"):
        done = command(verb, "--control", without.path)
        assert (done.returncode, done.stdout, done.stderr) == (0, "BP-STATUS-OK\n", "")
    done = command("activate", "vardis", "--control", without.path)
    assert (done.returncode, done.stderr) == (2, "dcp-node: this node runs without VarDis\n")


def test_watching_variables_and_payloads(node):
    first, second = node(), node()
    with first.client() as maker, second.client():
        watch = [sys.executable, "-m", "dcp_stack.cli"]
        control = ["--control", str(second.path), "--json", "--for", str(PATIENCE)]
        variables = subprocess.Popen([*watch, "var", "watch", "--count", "3", *control], stdout=subprocess.PIPE)
        assert command("bp", "register", 4660, "--mode", "once", "--control", second.path).returncode == 0
        payloads = subprocess.Popen([*watch, "bp", "watch", "4660", "--count", "1", *control], stdout=subprocess.PIPE)
        with second.client() as client:
            # The watchers, and the two connections of this test.
            eventually(lambda: client.call("UT-Status")["runtime"]["sessions"] == 4, "the watchers are connected")
        maker.call("RTDB-Create", varId=1, repCnt=2, descr="x", value="00")
        assert maker.call("BP-RegisterProtocol", protId=4660, name="", maxPayloadSize=4,
                          queueingMode="BP_QMODE_REPEAT")["status"] == "BP-STATUS-OK"  # fmt: skip
        assert maker.call("BP-TransmitPayload", protId=4660, payload="00ff")["status"] == "BP-STATUS-OK"
        shown = lines(payloads.communicate(timeout=PATIENCE)[0].decode())
        assert shown[0]["payload"] == "00ff"
        assert shown[0]["senderId"] == first.node_id
        for value in ("01", "02"):
            maker.call("RTDB-Update", varId=1, value=value)
            with second.client() as client:
                eventually(lambda value=value: client.call("RTDB-Read", varId=1).get("value") == value, "an update")
        changes = lines(variables.communicate(timeout=PATIENCE)[0].decode())
        assert [(each["event"], each["value"]) for each in changes] == [
            ("created", "00"),
            ("updated", "01"),
            ("updated", "02"),
        ]


def test_the_control_socket_is_private_and_removed_with_the_node(node):
    running = node()
    running.client().close()
    assert stat.S_IMODE(running.path.lstat().st_mode) == 0o600
    second = command("run", "--link", LINK, "--control", running.path)
    assert second.returncode == 2
    assert "another node listens there" in second.stderr
    assert running.end() == 0
    assert not running.path.exists()


def test_a_stale_socket_is_replaced(node, tmp_path):
    with socket.socket(socket.AF_UNIX) as listener:
        listener.bind(str(tmp_path / "node1.sock"))
    with node().client() as client:
        assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"


def test_misbehaving_clients_do_not_affect_others(node):
    running = node()
    good = running.client()
    # Not JSON, too long, vanished in the middle, unknown method: each on a connection of its own.
    with raw(running.path) as client:
        client.sendall(b"\x00\xff nonsense\n")
        assert answers(client, 1)[0]["error"]["code"] == -32700
        client.sendall(b"x" * (1 << 20) + b"y\n" + HELLO)
        too_long, hello = answers(client, 2)
        assert too_long["error"]["code"] == -32600
        assert hello["result"]["status"] == "UT-STATUS-OK"
    with raw(running.path) as client:
        client.sendall(b'{"jsonrpc": "2.0", "id"')
    with raw(running.path) as client:
        client.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, b"\1\0\0\0\0\0\0\0")
        client.sendall(HELLO * 100)
    assert good.call("UT-Hello")["status"] == "UT-STATUS-OK"
    eventually(lambda: good.call("UT-Status")["runtime"]["sessions"] == 1, "the others are forgotten")
    good.close()


def test_a_client_that_does_not_read_delays_no_other_client(node):
    running = node()
    good = running.client()
    request = b'{"jsonrpc":"2.0","id":1,"method":"UT-Status"}\n'
    with raw(running.path) as deaf:
        deaf.setblocking(False)
        sent = 0
        refused = 0
        # The node stops reading; others are served. At first it may only not have come to reading yet.
        while refused < 20:
            try:
                sent += deaf.send((request * 100)[sent % len(request) :])
                refused = 0
            except BlockingIOError:
                assert good.call("UT-Hello")["status"] == "UT-STATUS-OK"
                refused += 1
        memory = resident(running.popen.pid)
        assert memory < 80_000
        # A client that reads at last gets all answers.
        deaf.setblocking(True)
        deaf.settimeout(PATIENCE)
        with deaf.makefile("rb") as stream:
            for _ in range(sent // len(request)):
                assert json.loads(stream.readline())["result"]["status"] == "UT-STATUS-OK"
    good.close()


def resident(pid: int) -> int:
    status = Path(f"/proc/{pid}/status").read_text()
    return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmRSS"))


def test_a_client_that_ends_its_side_gets_its_answers(node):
    running = node()
    running.client().close()
    with raw(running.path) as client:
        client.sendall(HELLO * 20 + HELLO.rstrip())
        client.shutdown(socket.SHUT_WR)
        with client.makefile("rb") as stream:
            assert len(stream.readlines()) == 21


def test_too_many_clients(node):
    running = node()
    good = running.client()
    crowd = [raw(running.path) for _ in range(70)]
    eventually(lambda: good.call("UT-Status")["runtime"]["sessions"] == 64, "the crowd is let in")
    refused = 0
    for each in crowd:
        try:
            each.sendall(HELLO)
            refused += not each.recv(1)
        except OSError:
            refused += 1
    assert refused == 7
    with pytest.raises(ControlError, match="too many clients"), ControlClient(running.path) as late:
        late.call("UT-Hello")
    for each in crowd:
        each.close()
    eventually(lambda: good.call("UT-Status")["runtime"]["sessions"] == 1, "the crowd is forgotten")
    good.close()


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_shuts_the_node_down_orderly(node, tmp_path, number):
    recording = tmp_path / "flight.mcap"
    running = node("--record", str(recording), "--position", "track:circle")
    with running.client() as client:
        eventually(lambda: client.call("UT-Status")["runtime"]["recording"]["frames"] >= 2, "two beacons")
        with running.client() as waiting:
            assert running.end(number) == 0
            with pytest.raises(ControlError, match="closed the connection"):
                waiting.wait()
    assert any("event=ended" in line for line in running.log)
    with open_capture(recording) as reader:
        assert len(list(reader)) >= 2
        assert reader.problems == []
    # A second recording does not replace the first.
    shown = command("run", "--link", LINK, "--record", recording)
    assert shown.returncode == 2
    assert "recordings are not overwritten" in shown.stderr


def test_a_restarted_service_continues_recording(node, tmp_path):
    folder = tmp_path / "recordings"
    folder.mkdir()
    for end in (signal.SIGKILL, signal.SIGTERM):
        running = node("--record", f"{folder}/", "--position", "track:circle")
        with running.client() as client:
            recording = eventually(lambda client=client: client.call("UT-Status")["runtime"]["recording"], "it records")
        assert Path(recording["path"]).parent == folder
        running.end(end)
        assert any(recording["path"] in line for line in running.log)
    assert len(list(folder.iterdir())) == 2
    shown = command("run", "--link", LINK, "--record", f"{tmp_path}/none/")
    assert shown.returncode == 2
    assert f"there is no folder {tmp_path}/none" in shown.stderr


def test_watching_reports_missing_variables(node):
    running = node()
    with running.client() as client:
        for number in (9, 7):
            client.call("RTDB-Create", varId=number, repCnt=3, descr="x", value="0a")
    shown = command("var", "list", "--json", "--control", running.path)
    assert [each["varId"] for each in json.loads(shown.stdout)["variables"]] == [7, 9]
    shown = command("var", "watch", "300", "7", "8", "--for", "0.1", "--control", running.path)
    assert shown.returncode == 0
    assert "not in the database yet: 8, 300" in shown.stderr
    assert shown.stdout.split()[1:3] == ["7", "is"]
    shown = command("var", "watch", "7", "--for", "0.1", "--control", running.path)
    assert (shown.returncode, shown.stderr) == (0, "")


def test_standard_input_and_output_as_the_control_interface():
    requests = HELLO.decode() + '{"jsonrpc":"2.0","id":2,"method":"RTDB-DescribeDatabase"}'
    shown = command("run", "--link", LINK, "--node-id", "02:00:00:00:00:01", "--control", "stdio", stdin=requests)
    assert shown.returncode == 0
    first, second = lines(shown.stdout)
    assert first["result"]["nodeId"] == "02:00:00:00:00:01"
    assert second["result"]["variables"] == []


def test_standard_input_may_be_a_file(tmp_path):
    (tmp_path / "requests").write_bytes(HELLO * 3)
    with (tmp_path / "requests").open() as stdin, (tmp_path / "answers").open("w") as stdout:
        run = [sys.executable, "-m", "dcp_stack.cli", "run", "--link", LINK, "--control", "stdio"]
        assert subprocess.run(run, stdin=stdin, stdout=stdout, stderr=subprocess.DEVNULL, check=False).returncode == 0
    assert len(lines((tmp_path / "answers").read_text())) == 3


def test_positions_from_standard_input(node, tmp_path):
    running = node("--position", "stdin", stdin=subprocess.PIPE)
    listener = node(*patient(tmp_path))
    with listener.client() as client:
        running.client().close()
        running.popen.stdin.write('nonsense\n{"x": 1.5, "y": 2, "z": 3}\n')
        running.popen.stdin.flush()
        (seen,) = eventually(lambda: client.call("SRP-NeighbourTable")["neighbours"], "the report arrives")
        assert seen["position"] == [1.5, 2.0, 3.0]
    running.popen.stdin.close()
    with running.client() as client:
        eventually(lambda: client.call("UT-Status")["runtime"]["positions"]["finished"], "the end of input is seen")


def test_the_neighbour_file(node, tmp_path):
    published = tmp_path / "neighbours"
    running = node("--neighbour-file", str(published))
    node("--position", "track:line,speed=0,x=7").client().close()
    running.client().close()
    reader = NeighbourFileReader(published)
    entries = eventually(lambda: reader.snapshot().entries, "the neighbour is published")
    assert entries[0].node_id.hex(":") == "02:00:00:00:00:02"
    assert entries[0].position[0] == pytest.approx(7)
    assert running.end() == 0
    assert not published.exists()


def test_metrics(node):
    pytest.importorskip("prometheus_client")
    from prometheus_client.openmetrics.parser import text_string_to_metric_families

    port = own_port()
    running = node("--metrics", str(port), "--position", "track:circle")
    with running.client() as client:
        eventually(lambda: client.call("UT-Status")["node"]["bp"]["next_seqno"] > 1, "beacons are sent")
    url = f"http://127.0.0.1:{port}"
    with urllib.request.urlopen(f"{url}/metrics", timeout=PATIENCE) as response:
        assert response.headers["Content-Type"].startswith("application/openmetrics-text")
        families = {each.name: each for each in text_string_to_metric_families(response.read().decode())}
    assert families["dcp_bp_beacons_sent"].samples[0].value > 1
    assert families["dcp_bp_beacons_sent"].documentation == "Beacons passed to the link."
    assert families["dcp_link_send_errors"].samples[0].value == 0
    assert not [name for name, each in families.items() if not each.documentation.endswith(".")]
    assert families["dcp_node"].samples[0].labels["node_id"] == "02:00:00:00:00:01"
    assert families["dcp_link_sent"].samples[0].value > 1
    for path, headers, status in (("/x", {}, 404), ("/metrics", {"Host": "evil.example"}, 403)):
        with pytest.raises(urllib.error.HTTPError) as refused:
            urllib.request.urlopen(urllib.request.Request(url + path, headers=headers), timeout=PATIENCE)
        assert refused.value.code == status
        refused.value.close()
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as client:
        client.sendall(b"\xff\xfe\r\n\r\n")
        assert client.recv(100).startswith(b"HTTP/1.0 400")
    with running.client() as client:
        assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"


def test_a_flood_does_not_stop_beacons_or_answers(node):
    running = node("--position", "track:circle,rate=40")
    codec = Codec("dcp-2.0")
    flood = open_udp(GROUP, PORT)
    with running.client() as client:
        eventually(lambda: client.call("UT-Status")["node"]["bp"]["next_seqno"] > 1, "beacons are sent")
        before = client.call("UT-Status")
        foreign = bytes.fromhex("01497e0200000000031112000500010000000000010001ff")
        beacons = [foreign, foreign[:10], b"", bytes(range(256)), codec.profile.name.encode()]
        sent = 0

        def flooded() -> dict | None:
            nonlocal sent
            for _ in range(200):
                flood.send(beacons[sent % len(beacons)])
                sent += 1
            # Each of these is an answer in the flood.
            after = client.call("UT-Status")
            on_air = after["node"]["bp"]["next_seqno"] - before["node"]["bp"]["next_seqno"]
            if sent < 5_000 or on_air < 30:
                return None
            return after if slots_a_second(before, after) == pytest.approx(10, rel=0.12) else None

        # test_driver tests how many frames may be processed before a beacon that is due.
        after = eventually(flooded, "beacons in the flood", pause=0)
    flood.close()
    assert sum(after["drops"].values()) > 1000


def test_beacons_come_at_their_rate(node):
    running = node("--position", "track:circle,rate=100", "--beacon-period", "20", "--seed", "1")
    with running.client() as client:
        eventually(lambda: client.call("UT-Status")["node"]["bp"]["next_seqno"] > 1, "beacons are sent")
        # 100 intervals of 10 % jitter: a standard deviation of 0.6 %, and one beacon at each edge.
        keeps_rate(client, client.call("UT-Status"), 50, rel=0.05, seconds=2)


@pytest.mark.skipif(os.geteuid() != 0, reason="only root can give up being root")
def test_privileges_are_given_up(node, tmp_path):
    running = node("--user", "nobody")
    with running.client() as client:
        assert client.call("UT-Hello")["status"] == "UT-STATUS-OK"
    status = dict(line.split(":", 1) for line in Path(f"/proc/{running.popen.pid}/status").read_text().splitlines())
    assert "0" not in status["Uid"].split()
    assert running.path.lstat().st_uid != 0


def test_an_interface_without_privilege(tmp_path):
    if os.geteuid() != 0:
        shown = command("run", "--interface", "lo")
    else:
        # Still root, as the checkout may be unreadable for other users, but without capabilities.
        setpriv = ["setpriv", "--bounding-set", "-all", "--inh-caps", "-all", sys.executable, "-m", "dcp_stack.cli"]
        shown = subprocess.run(
            [*setpriv, "run", "--interface", "lo"], capture_output=True, text=True, check=False, timeout=PATIENCE
        )
    assert shown.returncode == 2
    assert "dcp-node: eth:lo" in shown.stderr
    assert "Traceback" not in shown.stderr
