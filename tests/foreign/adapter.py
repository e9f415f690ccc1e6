"""The adapter: serves the contract (conformance/UPPER-TESTER.md) on a Unix socket by asking the daemon on another."""

from __future__ import annotations

import json
import os
import socket
import threading
import time
from typing import Any

from switches import Switches

#: A status of the implementation's own.
FOREIGN_STATUS = "INTERNAL_SHARED_MEMORY_ERROR"
INTERNAL_ERROR = -32603
METHOD_NOT_FOUND = -32601

Message = dict[str, Any]


def run(switches: Switches) -> None:
    """Serve until the daemon has ended, and as long afterwards as the switches say."""
    adapter = Adapter(switches)
    threading.Thread(target=adapter.watch, daemon=True).start()
    adapter.serve()


class Adapter:
    """State shared by the clients of one adapter."""

    def __init__(self, switches: Switches) -> None:
        self.switches = switches
        self.dead = threading.Event()
        """The daemon has ended."""
        self.bp_active = True
        self._watched = socket.socket(socket.AF_UNIX)
        self._watched.connect(switches.daemon_socket)
        self.hello = self._ask_hello()

    def _ask_hello(self) -> Message:
        """The daemon's own answer to UT-Hello, less what this implementation does not have or tell."""
        self._watched.sendall(b'{"jsonrpc": "2.0", "id": 1, "method": "UT-Hello"}\n')
        answer: Message = json.loads(self._watched.makefile("rb").readline())["result"]
        hidden = {*self.switches.hides, *(() if self.switches.reset else ("UT-Reset",))}
        methods = [name for name in answer["methods"] if name not in hidden]
        told = {name: answer[name] for name in self.switches.tells if name in answer}
        return {
            "status": "UT-STATUS-OK",
            "name": "foreign",
            "version": "0.1",
            "specVersion": answer["specVersion"],
            "methods": methods,
            **told,
        }

    def watch(self) -> None:
        """Notice the end of the daemon, and end after it."""
        while self._watched.recv(4096):
            pass
        self.dead.set()
        after = self.switches.adapter_after
        if after is not None:
            time.sleep(max(0.0, after))
            os._exit(0)

    def serve(self) -> None:
        """Let clients in."""
        with socket.socket(socket.AF_UNIX) as door:
            door.bind(self.switches.adapter_socket)
            door.listen()
            while True:
                client, _ = door.accept()
                threading.Thread(target=Connection(self, client).run, daemon=True).start()


class Connection:
    """One client, with a connection to the daemon of its own."""

    def __init__(self, adapter: Adapter, client: socket.socket) -> None:
        self._adapter = adapter
        self._switches = adapter.switches
        self._client = client
        self._writing = threading.Lock()
        self._pending: dict[Any, str] = {}
        self._daemon: socket.socket | None = None

    def run(self) -> None:
        """Carry out what the client asks, in order."""
        daemon = socket.socket(socket.AF_UNIX)
        try:
            daemon.connect(self._switches.daemon_socket)
        except OSError:
            daemon.close()
        else:
            self._daemon = daemon
            threading.Thread(target=self._pass_back, args=(daemon,), daemon=True).start()
        try:
            for line in self._client.makefile("rb"):
                if line.strip():
                    self._take(json.loads(line))
        except (OSError, ValueError):
            pass
        finally:
            if self._daemon is not None:
                self._daemon.close()
            self._client.close()

    def _take(self, request: Message) -> None:
        method, number = request["method"], request.get("id")
        time.sleep(self._switches.call_delay)
        if method == "UT-Hello":
            self._say({"jsonrpc": "2.0", "id": number, "result": self._adapter.hello})
            return
        if method not in self._adapter.hello["methods"]:
            self._say(refusal(number, METHOD_NOT_FOUND, f"no method {method!r}"))
            return
        self._pending[number] = method
        if self._adapter.dead.is_set() or self._daemon is None:
            self._give_up()
            return
        try:
            self._daemon.sendall(json.dumps(request).encode() + b"\n")
        except OSError:
            self._give_up()

    def _pass_back(self, daemon: socket.socket) -> None:
        """Forward messages of the daemon to the client."""
        try:
            for line in daemon.makefile("rb"):
                message = json.loads(line)
                method = self._pending.pop(message.get("id"), "") if "method" not in message else ""
                self._say(self._as_violation(method, message))
        except (OSError, ValueError):
            pass
        self._give_up()

    def _give_up(self) -> None:
        """Answer what the daemon will not answer any more."""
        kind = self._switches.without_daemon
        for number in list(self._pending):
            method = self._pending.pop(number, "")
            if kind == "error":
                self._say(refusal(number, INTERNAL_ERROR, f"{method}: the daemon does not answer"))
            elif kind == "status":
                self._say({"jsonrpc": "2.0", "id": number, "result": {"status": FOREIGN_STATUS}})

    def _as_violation(self, method: str, message: Message) -> Message:
        """The daemon's answer, or what this adapter makes of it."""
        result = message.get("result")
        if not isinstance(result, dict):
            return message
        status, ok = str(result.get("status", "")), str(result.get("status", "")).endswith("-OK")
        if method in ("BP-MGMT-Activate", "BP-MGMT-Deactivate") and ok:
            self._adapter.bp_active = method == "BP-MGMT-Activate"
        changed = "conforming"
        if method in ("RTDB-Create", "RTDB-Update", "RTDB-Delete") and status.endswith("-INACTIVE"):
            changed = self._switches.while_inactive
        elif method == "BP-TransmitPayload" and not self._adapter.bp_active:
            changed = self._switches.transmit_while_inactive
        if changed == "status":
            return {**message, "result": {"status": FOREIGN_STATUS}}
        if changed == "error":
            return refusal(message["id"], INTERNAL_ERROR, f"{method}: the shared memory segment is locked")
        return message

    def _say(self, message: Message) -> None:
        with self._writing:
            try:
                self._client.sendall(json.dumps(message).encode() + b"\n")
            except OSError:
                return


def refusal(number: Any, code: int, text: str) -> Message:
    """A JSON-RPC error."""
    return {"jsonrpc": "2.0", "id": number, "error": {"code": code, "message": text}}
