"""The foreign-like implementation does what its switches say."""

from __future__ import annotations

import json
import socket
import time
from pathlib import Path

import pytest

from .faults import FAULTS, with_faults
from .rig import PATIENCE, Foreign, foreign

SANITY = "TC_DCP_SANITY_BV_01"


class Client:
    """A connection to the adapter."""

    def __init__(self, target: Foreign) -> None:
        self._socket = socket.socket(socket.AF_UNIX)
        self._socket.settimeout(PATIENCE)
        deadline = time.monotonic() + PATIENCE
        while True:
            try:
                self._socket.connect(target.switches.adapter_socket)
                break
            except OSError:
                assert time.monotonic() < deadline
                time.sleep(0.01)
        self._lines = self._socket.makefile("rb")

    def __enter__(self) -> Client:
        return self

    def __exit__(self, *_: object) -> None:
        self._lines.close()
        self._socket.close()

    def call(self, method: str, **params: object) -> dict:
        """The answer to a call; empty when the adapter has gone."""
        message = {"jsonrpc": "2.0", "id": 1, "method": method, "params": params}
        try:
            self._socket.sendall(json.dumps(message).encode() + b"\n")
            while line := self._lines.readline():
                answer = json.loads(line)
                if "method" not in answer:
                    return answer
        except OSError:
            pass
        return {}


def until(look, what: str) -> None:
    deadline = time.monotonic() + PATIENCE
    while not look():
        assert time.monotonic() < deadline, what
        time.sleep(0.01)


REPEAT = {"protId": 9, "name": "x", "maxPayloadSize": 9, "queueingMode": "BP_QMODE_REPEAT"}


def kill(client: Client) -> None:
    assert client.call("BP-RegisterProtocol", **REPEAT)["result"]["status"] == "BP-STATUS-OK"
    client.call("BP-ClearBuffer", protId=9)


@pytest.mark.parametrize("link", ["udp", "ethernet"])
def test_the_foreign_node_joins_the_network(link):
    with foreign(link=link, srp="process", poll_ms=5) as target:
        run = target.run(SANITY)
        assert run.status == 0, run.text
        assert [each["verdict"] for each in run.cases] == ["pass"]
        until(lambda: not any(map(target.alive, ("launcher", "daemon", "adapter", "srp"))), "it was ended")


@pytest.mark.parametrize("after", [0.0, 0.3])
def test_the_adapter_ends_with_the_daemon(after):
    with foreign(faults=["crashes-on-clear-buffer"], adapter_after=after, launcher="stays") as target, target.started():
        with Client(target) as client:
            kill(client)
            until(lambda: not target.alive("daemon"), "the daemon dies")
            died = time.monotonic()
            until(lambda: not target.alive("adapter"), "the adapter dies")
            assert time.monotonic() - died >= after * 0.6
        assert target.alive("launcher")


def test_the_adapter_ends_first():
    with foreign(faults=["crashes-on-clear-buffer"], adapter_after=-0.5) as target, target.started():
        with Client(target) as client:
            kill(client)
        until(lambda: not target.alive("adapter"), "the adapter dies")
        assert target.alive("daemon")
        until(lambda: not target.alive("launcher"), "the daemon dies and the start script ends with it")


@pytest.mark.parametrize("without", ["error", "status"])
def test_the_adapter_outlives_the_daemon(without):
    switches = {"adapter_after": None, "without_daemon": without}
    with foreign(faults=["crashes-on-clear-buffer"], **switches) as target, target.started():
        with Client(target) as client:
            kill(client)
            until(lambda: not target.alive("daemon"), "the daemon dies")
            answer = client.call("RTDB-DescribeDatabase")
            assert ("error" in answer) == (without == "error")
            assert without == "error" or answer["result"]["status"] == "INTERNAL_SHARED_MEMORY_ERROR"
        with Client(target) as client:
            assert client.call("UT-Hello")["result"]["name"] == "foreign"
        assert target.alive("adapter")


def test_a_daemon_that_exits_later():
    with foreign(faults=["crashes-on-clear-buffer"], death="exits", death_delay=0.3) as target, target.started():
        with Client(target) as client:
            kill(client)
            assert client.call("RTDB-DescribeDatabase")["result"]["status"] == "VARDIS-STATUS-OK"
        until(lambda: not target.alive("daemon"), "the daemon dies")


def test_a_daemon_that_hangs():
    with foreign(faults=["crashes-on-clear-buffer"], death="hangs") as target, target.started():
        with Client(target) as client:
            kill(client)
        stat = Path(f"/proc/{target.switches.pid_of('daemon')}/stat")
        until(lambda: stat.read_text().split()[2] == "T", "the daemon hangs")
        assert target.alive("daemon")
        assert target.alive("adapter")


def test_answers_of_the_adapter():
    switches = {"while_inactive": "status", "transmit_while_inactive": "error", "hides": ["BP-SetParameter"]}
    with foreign(call_delay=0.1, tells=[], **switches) as target, target.started(), Client(target) as client:
        begun = time.monotonic()
        hello = client.call("UT-Hello")["result"]
        assert time.monotonic() - begun >= 0.1
        assert not {"UT-Reset", "BP-SetParameter"} & set(hello["methods"])
        assert "nodeId" not in hello
        assert client.call("UT-Reset")["error"]["code"] == -32601
        client.call("VD-MGMT-Deactivate")
        status = client.call("RTDB-Update", varId=1, value="00")["result"]["status"]
        assert status == "INTERNAL_SHARED_MEMORY_ERROR"
        client.call("BP-RegisterProtocol", **REPEAT)
        assert client.call("BP-TransmitPayload", protId=9, payload="00")["result"]["status"] == "BP-STATUS-OK"
        client.call("BP-MGMT-Deactivate")
        assert client.call("BP-TransmitPayload", protId=9, payload="00")["error"]["code"] == -32603


class NoVictim:
    def die(self, words: str, after: float = 0.0) -> None:
        raise AssertionError(words)


def test_faults_have_names():
    for name in FAULTS:
        assert with_faults([name], NoVictim())
    assert with_faults(["M-VD-PS-01-ignored", "magic-swapped"], NoVictim(), poll_ms=5)
    with pytest.raises(KeyError):
        with_faults(["M-NO-SUCH"], NoVictim())
