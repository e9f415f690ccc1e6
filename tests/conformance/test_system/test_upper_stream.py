"""Upper testers over sockets and programs: those that keep to the contract, and those that hang, lie or die."""

from __future__ import annotations

import json
import os
import select
import shlex
import socket
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from dcp_conformance import upper_tester as uppers
from dcp_conformance.errors import NoListenerError, UpperTesterError, UsageError
from dcp_conformance.upper_tester.patience import Patience
from dcp_conformance.upper_tester.stream import DROPPED, MOST_NOTIFICATIONS

from ...waiting import PATIENCE

pytestmark = pytest.mark.part("links")


def open_upper(spec: str, patience: float = PATIENCE, **keys: bool) -> uppers.Reconnecting:
    """An upper tester that waits for a program as long as the machine takes to start it."""
    return uppers.open_upper(spec, patience, **keys)


#: An adapter that keeps to the contract, and what can be put in the place of its parts. It answers one line at a time.
ADAPTER = """
import json, sys, time
hello = {"status": "UT-STATUS-OK", "name": "fake", "version": "1", "specVersion": "2.0", "methods": ["UT-Hello", "X"]}
def say(**members):
    print(json.dumps({"jsonrpc": "2.0", **members}), flush=True)
def nonsense(request):
    say(id=request["id"], error={"code": -32601, "message": "no such method"})
def greet(request):
    say(id=request["id"], result=hello)
def other(request):
    say(id=request["id"], result={"status": "VARDIS-STATUS-OK", "method": request["method"]})
%s
for line in sys.stdin:
    request = json.loads(line)
    if "NoSuchMethod" in request["method"]:
        nonsense(request)
    elif request["method"] == "UT-Hello":
        greet(request)
    else:
        other(request)
"""


def adapter(tmp_path: Path, code: str = "") -> str:
    """The specification of an upper tester that is this adapter."""
    path = tmp_path / "adapter.py"
    path.write_text(ADAPTER % code)
    return f"exec:{shlex.quote(sys.executable)} {path}"


def test_a_program_that_keeps_to_the_contract(tmp_path):
    upper = open_upper(adapter(tmp_path))
    try:
        assert upper.methods == {"UT-Hello", "X"}
        assert upper.about["name"] == "fake"
        answer = upper.call("X", {"varId": 1})
        assert answer.ok
        assert answer.result["method"] == "X"
        assert upper.poll() == []
        assert upper.another() is None
        assert all(os.fstat(each) for each in upper.filenos())
    finally:
        upper.close()
        upper.close()
    assert upper.filenos() == ()
    with pytest.raises(UpperTesterError, match="closed"):
        upper.call("X", {})


LIES = {
    "answers OK to anything": (
        "nonsense = other",
        r"UT-NoSuchMethod-\w+, which does not exist, is answered with VARDIS-STATUS-OK instead of error -32601",
    ),
    "another error for anything": (
        "def nonsense(r): say(id=r['id'], error={'code': -32603, 'message': 'oh'})",
        "is answered with error -32603: oh instead",
    ),
    "no methods": ("del hello['methods']", "there is no member `methods`"),
    "version is a number": ("hello['version'] = 3", "version: expected `str`, got `int`"),
    "a method that is not a name": ("hello['methods'] = [1]", r"methods\[0\]: expected `str`, got `int`"),
    "hello fails": ("hello['status'] = 'VARDIS-STATUS-INACTIVE'", "UT-Hello is answered with VARDIS-STATUS-INACTIVE"),
    "hello without status": ("del hello['status']", "a result without a status"),
    "not JSON": ("print('starting up...', flush=True)", "not JSON .*: starting up"),
    "JSON that is not a message": ("print('[1]', flush=True)", r"JSON that is not a message: \[1\]"),
    "neither nor": ("say(method=5)", "neither a response nor a notification"),
    "deep JSON": ("print('[' * 100000, flush=True)", "not JSON"),
}


@pytest.mark.parametrize("lie", LIES)
def test_wrong_answers_while_connecting(tmp_path, lie):
    code, message = LIES[lie]
    with pytest.raises(UpperTesterError, match=message) as caught:
        open_upper(adapter(tmp_path, code))
    assert str(caught.value).startswith("exec:")


LATER = {
    "the wrong id": (
        "def other(r): say(id=99, result={'status': 'BP-STATUS-OK'})",
        "answers with the id 99, which no request that waits has",
    ),
    "no id": ("def other(r): say(result={'status': 'BP-STATUS-OK'})", "answers with the id null"),
    "no status": ("def other(r): say(id=r['id'], result={})", "X: a result without a status"),
    "no result": ("def other(r): say(id=r['id'])", "a result without a status"),
    "an error without code": ("def other(r): say(id=r['id'], error={'message': 'x'})", "an error without code"),
}


@pytest.mark.parametrize("lie", LATER)
def test_wrong_answers_later(tmp_path, lie):
    code, message = LATER[lie]
    upper = open_upper(adapter(tmp_path, code))
    try:
        with pytest.raises(UpperTesterError, match=message):
            upper.call("X", {})
        # A wrong answer does not make the connection unusable.
        assert upper.call("UT-Hello", {}).ok
    finally:
        upper.close()


@pytest.mark.parametrize(
    "error", [{"code": -32003, "message": "cannot be reached"}, {"code": -32603, "message": "connection refused"}]
)
def test_an_adapter_that_is_there_before_the_implementation_is_asked_again(tmp_path, error):
    code = f"asked = []\nrefuse = nonsense\ndef nonsense(r):\n    asked.append(r)\n    error = {error}\n"
    code += "    refuse(r) if len(asked) > 2 else say(id=r['id'], error=error)"
    upper = open_upper(adapter(tmp_path, code))
    assert upper.methods == {"UT-Hello", "X"}
    upper.close()
    with pytest.raises(NoListenerError, match=f"the adapter cannot reach the implementation: error {error['code']}"):
        open_upper(adapter(tmp_path, code.replace("> 2", "> 1000000")), patience=1)


def test_a_status_that_the_specification_lacks_is_an_answer_of_the_implementation(tmp_path):
    upper = open_upper(adapter(tmp_path, "def other(r): say(id=r['id'], result={'status': 'VARDIS-OK'})"))
    try:
        odd = upper.call("X", {})
        assert (odd.status, odd.known, odd.ok, odd.asked) == ("VARDIS-OK", False, False, True)
        assert str(odd) == "'VARDIS-OK', a status that the specification does not have"
        # The contract's own methods are answered by the adapter, not by the implementation.
        with pytest.raises(UpperTesterError, match="UT-Reset: answers with the status 'VARDIS-OK'; UT-STATUS-OK is"):
            upper.call("UT-Reset", {})
    finally:
        upper.close()


def test_a_program_that_hangs(tmp_path):
    waiting = f"while not pathlib.Path({str(tmp_path / 'go')!r}).exists(): time.sleep(0.01)"
    code = f"import pathlib\ndef other(r):\n    {waiting}\n    say(id=r['id'], result=hello)"
    upper = open_upper(adapter(tmp_path, code))
    try:
        # As if it had been opened with little patience; Python itself takes longer than that to start.
        upper._patience = Patience(0.2)
        begun = time.monotonic()
        with pytest.raises(UpperTesterError, match=r"X was not answered within 0.2 s; does the implementation hang"):
            upper.call("X", {})
        assert time.monotonic() - begun < PATIENCE
        upper._patience = Patience(PATIENCE)
        (tmp_path / "go").touch()
        # A late answer is not matched to another request.
        assert upper.call("UT-Hello", {}).ok
        assert upper.call("X", {}).result["name"] == "fake"
    finally:
        upper.close()


def test_endless_output_counts_as_hanging(tmp_path):
    upper = open_upper(adapter(tmp_path, "def other(r):\n    while True: say(method='M', params={})"))
    try:
        upper._patience = Patience(0.3)
        begun = time.monotonic()
        with pytest.raises(UpperTesterError, match="not answered within"):
            upper.call("X", {})
        assert time.monotonic() - begun < PATIENCE
        upper.poll()
        assert time.monotonic() - begun < PATIENCE
    finally:
        upper.close()


DEATHS = {
    "exit": ("sys.exit('out of memory')", "exit status 1; its output: out of memory"),
    "signal": ("import os; os.kill(os.getpid(), 9)", "signal SIGKILL; it wrote nothing"),
    "exception": ("raise KeyError('varId')", r"exit status 1; its output: .*KeyError: 'varId'"),
    "many words": ("[print('line', i, file=sys.stderr) for i in range(20000)]; sys.exit(3)", "line 19998 | line 19999"),
}


@pytest.mark.parametrize("death", DEATHS)
def test_a_program_that_dies(tmp_path, death):
    code, message = DEATHS[death]
    upper = open_upper(adapter(tmp_path, f"def other(r): {code}"))
    try:
        with pytest.raises(UpperTesterError, match=message.replace("|", r"\|")) as caught:
            upper.call("X", {})
        assert len(str(caught.value)) < 6000
        # The next call starts it again.
        assert upper.call("UT-Hello", {}).ok
    finally:
        upper.close()


def test_the_end_of_a_program_is_noticed_while_waiting(tmp_path):
    code = "def other(r): say(id=r['id'], result={'status': 'BP-STATUS-OK'}); sys.exit(4)"
    upper = open_upper(adapter(tmp_path, code))
    try:
        assert upper.call("X", {}).ok
        deadline = time.monotonic() + PATIENCE
        with pytest.raises(UpperTesterError, match="exit status 4"):  # noqa: PT012 - it may take a while to die
            while time.monotonic() < deadline:
                select.select(upper.filenos(), [], [], 1)
                upper.poll()
        # From then on there is nothing to wait for, and nothing that wakes up again and again.
        assert upper.filenos() == ()
        assert upper.poll() == []
    finally:
        upper.close()


def test_a_program_that_dies_at_once():
    with pytest.raises(UpperTesterError, match=r"exec:false: the program ended with exit status 1; it wrote nothing"):
        open_upper("exec:false")


def test_an_echo():
    begun = time.monotonic()
    with pytest.raises(UpperTesterError, match=r"exec:cat: sends a request instead of answering one: .* is it an echo"):
        open_upper("exec:cat", patience=600)
    assert time.monotonic() - begun < PATIENCE


def test_a_command_that_needs_a_shell():
    with pytest.raises(UpperTesterError, match=r"exit status 7; its output: one \| two"):
        open_upper("exec:(echo one; echo two) >&2 && exit 7")


def test_a_line_without_end(tmp_path):
    code = "def other(r):\n    while True: sys.stdout.write('x' * 65536)"
    upper = open_upper(adapter(tmp_path, code), patience=PATIENCE)
    try:
        with pytest.raises(UpperTesterError, match="a line of more than 16 MiB"):
            upper.call("X", {})
    finally:
        upper.close()


def test_a_program_that_reads_no_input(tmp_path):
    code = "def other(r): time.sleep(3600)"
    upper = open_upper(adapter(tmp_path, code))
    try:
        upper._patience = Patience(0.3)
        with pytest.raises(UpperTesterError, match="not answered"):
            upper.call("X", {})
        begun = time.monotonic()
        with pytest.raises(UpperTesterError, match="takes no more requests"):
            upper.call("X", {"value": "00" * 2_000_000})
        assert time.monotonic() - begun < PATIENCE
    finally:
        begun = time.monotonic()
        upper.close()
        assert time.monotonic() - begun < PATIENCE


def test_nothing_is_left_of_a_program(tmp_path):
    code = "import subprocess\nchild = subprocess.Popen(['sleep', '600'])\nhello['version'] = str(child.pid)"
    upper = open_upper(adapter(tmp_path, code))
    child = int(upper.about["version"])
    upper.close()
    deadline = time.monotonic() + PATIENCE
    while Path(f"/proc/{child}").exists() and "Z" not in Path(f"/proc/{child}/stat").read_text().split(")")[1][:3]:
        assert time.monotonic() < deadline
        time.sleep(0.01)


def test_notifications_are_kept_in_order_and_bounded(tmp_path):
    count = MOST_NOTIFICATIONS + 5
    code = (
        "def other(r):\n"
        f"    for n in range({count}): say(method='M', params={{'n': n}})\n"
        "    say(id=r['id'], result={'status': 'UT-STATUS-OK'})"
    )
    upper = open_upper(adapter(tmp_path, code))
    try:
        before = time.monotonic_ns()
        assert upper.call("X", {}).ok
        dropped, *rest = upper.poll()
        assert (dropped.method, dropped.params) == (DROPPED, {"number": 5})
        assert [each.params["n"] for each in rest] == list(range(5, count))
        assert before < rest[0].time <= rest[-1].time <= time.monotonic_ns()
        assert upper.poll() == []
    finally:
        upper.close()


class Server:
    """A thread that serves the contract on a listening socket, and counts its connections."""

    def __init__(self, listening: socket.socket) -> None:
        self._listening = listening
        self.connections: list[socket.socket] = []
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        while True:
            try:
                connection, _ = self._listening.accept()
            except OSError:
                return
            self.connections.append(connection)
            threading.Thread(target=self._answer, args=(connection, len(self.connections)), daemon=True).start()

    def _answer(self, connection: socket.socket, number: int) -> None:
        with connection, connection.makefile("rw") as stream:
            for line in stream:
                request = json.loads(line)
                reply: dict[str, Any] = {"error": {"code": -32601, "message": "no"}}
                if request["method"] == "UT-Hello":
                    about = {"name": "s", "version": str(number), "specVersion": "2.0", "methods": ["UT-Hello"]}
                    reply = {"result": {"status": "UT-STATUS-OK", **about}}
                stream.write(json.dumps({"jsonrpc": "2.0", "id": request["id"], **reply}) + "\r\n\r\n")
                stream.flush()

    def hang_up(self) -> None:
        """End all connections."""
        for each in self.connections:
            each.shutdown(socket.SHUT_RDWR)

    def end(self) -> None:
        """Stop serving."""
        self._listening.shutdown(socket.SHUT_RDWR)
        self._listening.close()
        self._thread.join(PATIENCE)


@pytest.fixture
def unix_server(tmp_path) -> Iterator[tuple[Server, Path]]:
    path = tmp_path / "ut.sock"
    listening = socket.socket(socket.AF_UNIX)
    listening.bind(str(path))
    listening.listen()
    server = Server(listening)
    yield server, path
    server.end()


def test_several_connections_over_a_unix_socket(unix_server):
    server, path = unix_server
    upper = open_upper(f"unix:{path}")
    second = upper.another()
    assert second is not None
    assert (upper.about["version"], second.about["version"]) == ("1", "2")
    assert len(server.connections) == 2
    second.close()
    assert upper.call("UT-Hello", {}).ok
    upper.close()


def test_a_connection_that_is_closed_is_noticed_and_opened_again(unix_server):
    server, path = unix_server
    upper = open_upper(f"unix:{path}")
    server.hang_up()
    with pytest.raises(UpperTesterError, match="closed by the other side; did the implementation or its adapter end"):
        upper.call("UT-Hello", {})
    assert upper.call("UT-Hello", {}).result["version"] == "2"
    upper.reconnect()
    assert upper.about["version"] == "3"
    upper.close()


@pytest.mark.parametrize("family", ["127.0.0.1", "[::1]"])
def test_tcp(family):
    kind = socket.AF_INET6 if "[" in family else socket.AF_INET
    listening = socket.socket(kind)
    try:
        listening.bind((family.strip("[]"), 0))
    except OSError:
        pytest.skip("no IPv6 on the loopback interface")
    listening.listen()
    server = Server(listening)
    upper = open_upper(f"tcp:{family}:{listening.getsockname()[1]}")
    assert upper.call("Y", {}).code == -32601
    upper.close()
    server.end()


def test_a_socket_that_appears_later_is_waited_for(tmp_path):
    path = tmp_path / "late.sock"
    listening = socket.socket(socket.AF_UNIX)
    servers = []

    def begin() -> None:
        listening.bind(str(path))
        listening.listen()
        servers.append(Server(listening))

    timer = threading.Timer(0.2, begin)
    timer.start()
    upper = open_upper(f"unix:{path}")
    assert upper.about["name"] == "s"
    upper.close()
    timer.join()
    servers[0].end()


USELESS = {
    "nothing:here": "not an upper tester; expected one of",
    "unix": "not an upper tester",
    "unix:": "not an upper tester",
    "exec:  ": "not an upper tester",
    "exec:'unclosed": "cannot be read: No closing quotation",
    "exec:/no/such/program --now": "/no/such/program cannot be started: No such file",
    "tcp:4711": "expected tcp:HOST:PORT",
    "tcp:host:0": "expected tcp:HOST:PORT",
    "tcp:host:70000": "expected tcp:HOST:PORT",
    "unix:/no/such/folder/x.sock": "there is no directory /no/such/folder",
    "unix:/tmp/" + "x" * 120: "at most 107 octets",
    "commands:/no/such.toml": "cannot be read: No such file or directory; built in are: cpp-tools",
    "commands:nothing": "cannot be read",
}


@pytest.mark.parametrize("spec", USELESS)
def test_invalid_specifications(spec):
    with pytest.raises(UsageError, match=USELESS[spec]):
        open_upper(spec)


def test_no_listener(tmp_path):
    with pytest.raises(UpperTesterError, match=r"there is no such socket, after 0.1 s"):
        open_upper(f"unix:{tmp_path}/nobody.sock", patience=0.1)
    path = tmp_path / "dead.sock"
    with socket.socket(socket.AF_UNIX) as once:
        once.bind(str(path))
    with pytest.raises(UpperTesterError, match="no process listens there"):
        open_upper(f"unix:{path}", patience=0.1)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        with pytest.raises(UpperTesterError, match=r"tcp:127.0.0.1:\d+: no process listens there"):
            open_upper(f"tcp:127.0.0.1:{free.getsockname()[1]}", patience=0.1)


def test_a_listener_that_the_tester_does_not_start_is_not_waited_for(tmp_path):
    for spec in (f"unix:{tmp_path}/nobody.sock", "tcp:127.0.0.1:1"):
        with pytest.raises(UpperTesterError, match=r"there is no such socket; is|no process listens there; is"):
            open_upper(spec, patience=0.5, starting=False)


def test_a_listener_that_disappeared_is_waited_for(unix_server):
    _, path = unix_server
    upper = open_upper(f"unix:{path}", starting=False)
    upper._patience = Patience(0.5)
    path.unlink()
    with pytest.raises(UpperTesterError, match=r"there is no such socket, after 0.5 s"):
        upper.reconnect()
    upper.close()
