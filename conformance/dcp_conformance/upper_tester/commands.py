"""Command lines as an upper tester: a TOML file says which program does what a method asks, and how to read its output.

For implementations that only ship small tools. The file is described in docs/upper-tester-commands.md. There are no
notifications this way, and only methods that some tool offers.
"""

from __future__ import annotations

import contextlib
import os
import re
import select
import shutil
import subprocess
import time
from typing import Any

from dcp_codec.common.child import end_group, ending
from dcp_codec.common.printable import printable
from dcp_conformance.errors import CouldNotAskError, NeverAnsweredError, NoAnswerError, UpperTesterError, UsageError

from .base import METHOD_NOT_FOUND, Answer, Notification, status_of_success
from .commands_file import Adapter, Method, Reading, converted, load_adapter, placeholders
from .patience import Patience

#: Octets of output of a command that are read.
MOST_OUTPUT = 1024 * 1024
#: Seconds that output may still come in after a command has ended.
_GRACE = 0.2


def open_commands(spec: str, patience: float) -> CommandUpperTester:
    """Open the upper tester of a file or built-in adapter; settings follow its name: ``FILE.toml,bin=/opt/dcp/``.

    ``patience``: s that a command may take, where the file does not say. Raises ``UsageError`` for a file that makes no
    sense, and for programs that are not there.
    """
    body, *given = re.split(r",(?=\w+=)", spec)
    settings = dict(each.split("=", 1) for each in given)
    adapter = load_adapter(body)
    for name in settings:
        if name not in adapter.settings:
            known = ", ".join(adapter.settings) or "none"
            raise UsageError(f"commands:{spec}: the adapter has no setting {name!r}; there are: {known}")
    return CommandUpperTester(f"commands:{spec}", adapter, {**adapter.settings, **settings}, patience)


class CommandUpperTester:
    """See :func:`open_commands`, which makes them."""

    def __init__(self, name: str, adapter: Adapter, settings: dict[str, str], patience: float) -> None:
        """Raises ``UsageError`` for programs that are not there, ``UpperTesterError`` if UT-Hello fails."""
        self.name = name
        self._adapter = adapter
        self._settings = settings
        self._patience = Patience(adapter.timeout or patience)
        # Without UT-Hello: the file describes the implementation, which is not a sign of life.
        self.methods = frozenset(adapter.methods) - {"UT-Hello"}
        self.about: dict[str, Any] = {
            "status": "UT-STATUS-OK",
            "name": adapter.name,
            "version": adapter.version,
            "specVersion": adapter.spec_version,
            "methods": sorted(self.methods),
        }
        if adapter.node_id:
            self.about["nodeId"] = adapter.node_id
        for method in adapter.methods.values():
            self._look_for(method)
        self.reconnect()

    def reconnect(self) -> None:
        """Identify the implementation again, if there is a command for it. Raises ``UpperTesterError``."""
        self._patience.renew()
        method = self._adapter.methods.get("UT-Hello")
        if method is not None:
            answer = self._carry_out("UT-Hello", method, {})
            if not answer.ok:
                raise UpperTesterError(f"{self.name}: UT-Hello: {answer}")
            self.about.update({name: value for name, value in answer.result.items() if name != "status"})

    def call(self, method: str, params: dict[str, Any]) -> Answer:
        """Run the command of a method. Raises ``UpperTesterError`` if its outcome is not to be understood."""
        known = self._adapter.methods.get(method)
        if known is not None:
            return self._carry_out(method, known, params)
        if method == "UT-Hello":
            return Answer("UT-STATUS-OK", dict(self.about))
        return Answer(code=METHOD_NOT_FOUND, message=f"the adapter has no command for {method}")

    def poll(self) -> list[Notification]:
        """Return an empty list: commands cannot notify."""
        return []

    def filenos(self) -> tuple[int, ...]:
        """Return no descriptors: a command runs for each call."""
        return ()

    def another(self) -> None:
        """Commands have no connection, so there is no second one."""
        return

    def close(self) -> None:
        """Has no effect: each command is a process of its own, which has ended."""

    # -- one command -------------------------------------------------------------------------------------------

    def _carry_out(self, name: str, method: Method, params: dict[str, Any]) -> Answer:
        where = f"{self.name}: {name}"
        values = {**method.defaults, **_texts(where, method, params)}
        # A parameter without a place in the command may be left out only if the command has it fixed to this value.
        for parameter, value in params.items():
            used = {parameter, f"{parameter}Text"} & placeholders(method)
            if not used and _text(value) != method.fixed.get(parameter):
                fixed = method.fixed.get(parameter)
                says = f"only with {fixed}" if fixed is not None else "not at all"
                raise CouldNotAskError(f"{where}: the command accepts {parameter} {says}, and not {value!r}")
        if why := self._patience.refused(name):
            raise CouldNotAskError(f"{self.name}: {why}")
        words = [self._filled(where, each, values) for each in method.command]
        given = self._filled(where, method.stdin, values).encode()
        begun, patience = time.monotonic(), self._patience.of(name, method.timeout or None)
        try:
            status, output = _run(where, words, given, patience)
        except NoAnswerError as error:
            learnt = self._patience.unanswered(name, where, patience)
            raise learnt if isinstance(learnt, NeverAnsweredError) else error from None
        self._patience.answered(name, begun)
        return self._answer(where, name, method, status, output)

    def _filled(self, where: str, template: str, values: dict[str, str]) -> str:
        def value(match: re.Match[str]) -> str:
            found = values.get(match[1], self._settings.get(match[1]))
            if found is None:
                raise CouldNotAskError(f"{where}: the command needs {match[1]}, which was not given")
            return found

        return re.sub(r"\{(\w+)\}", value, template)

    def _answer(self, where: str, name: str, method: Method, status: int, output: str) -> Answer:
        for pattern, code in method.errors.items():
            if found := re.search(pattern, output, re.MULTILINE):
                return Answer(code=code, message=found[0])
        status_text = self._status(method, output)
        if status_text is None and str(status) in method.exits:
            status_text = method.exits[str(status)]
        if status_text is None:
            success = status == 0 if method.success is None else re.search(method.success, output, re.MULTILINE)
            if success:
                status_text = method.ok or status_of_success(name)
        if status_text is None:
            raise UpperTesterError(
                f"{where}: the outcome cannot be understood (the command ended with {ending(status)}, and there is no "
                f"status in its output: {_shown(output)})"
            )
        members = self._members(where, method, output) if Answer(status_text).ok else {}
        return Answer(status_text, {"status": status_text, **members})

    def _status(self, method: Method, output: str) -> str | None:
        pattern = method.status or self._adapter.status
        found = re.search(pattern, output, re.MULTILINE) if pattern else None
        if found is None:
            return None
        text = found["status"]
        return printable(self._adapter.statuses.get(text, text))

    def _members(self, where: str, method: Method, output: str) -> dict[str, Any]:
        members: dict[str, Any] = {}
        if method.result is not None:
            found = re.search(method.result.pattern, output, re.MULTILINE)
            if found is None:
                raise UpperTesterError(f"{where}: its output is not as the adapter file expects: {_shown(output)}")
            members = _converted(where, method.result, found)
            if method.result.member:
                members = {method.result.member: members}
        if method.rows is not None:
            if method.rows.complete and re.sub(method.rows.pattern, "", output, flags=re.MULTILINE).strip():
                raise UpperTesterError(f"{where}: its output is not as the adapter file expects: {_shown(output)}")
            rows = re.finditer(method.rows.pattern, output, re.MULTILINE)
            members[method.rows.member] = [_converted(where, method.rows, each) for each in rows]
        return members

    def _look_for(self, method: Method) -> None:
        program = self._filled(self.name, method.command[0], {})
        if shutil.which(program) is None:
            hint = f"; settings: {', '.join(f'{key}={value}' for key, value in self._settings.items())}"
            raise UsageError(
                f"{self.name}: there is no program {program}{hint if self._settings else ''}; name its folder in the "
                "adapter file, or after its name (commands:FILE.toml,bin=/path/to/)"
            )


def _texts(where: str, method: Method, params: dict[str, Any]) -> dict[str, str]:
    """Return parameters as arguments of commands: as in JSON, and octets of a text as text under ``...Text``."""
    values: dict[str, str] = {}
    for name, value in params.items():
        text = _text(value)
        values[name] = text
        if f"{name}Text" in placeholders(method):
            try:
                values[f"{name}Text"] = bytes.fromhex(text).decode()
            except ValueError:
                raise CouldNotAskError(f"{where}: the command takes {name} as text, which {text!r} is not") from None
    for name, text in values.items():
        if "\0" in text:
            raise CouldNotAskError(f"{where}: a command line cannot hold the octet 0, which {name} has")
    return values


def _text(value: Any) -> str:
    """Return a parameter as in JSON, without quotes."""
    return str(value).lower() if isinstance(value, bool) else str(value)


def _converted(where: str, reading: Reading, found: re.Match[str]) -> dict[str, Any]:
    members = {}
    for name, text in found.groupdict().items():
        if text is None:
            continue
        kind = reading.types.get(name, "text")
        try:
            members[name] = converted(kind, text)
        except ValueError:
            raise UpperTesterError(f"{where}: {name} is {printable(text)!r}; expected {kind}") from None
    return members


def _run(where: str, words: list[str], given: bytes, patience: float) -> tuple[int, str]:
    """Exit status and output (standard output and error together, at most ``MOST_OUTPUT``) of a command."""
    try:
        process = subprocess.Popen(  # noqa: S603 - the command is the user's own
            words,
            stdin=subprocess.PIPE if given else subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            start_new_session=True,
        )
    except OSError as error:
        raise CouldNotAskError(f"{where}: {words[0]} cannot be started: {error.strerror or error}") from None
    assert process.stdout is not None
    output = bytearray()
    try:
        if process.stdin is not None:
            # The pipe takes this many octets at once: more than any parameter has.
            with contextlib.suppress(BrokenPipeError):
                process.stdin.write(given[:65_536])
                process.stdin.close()
        ended = _read_all(process, output, time.monotonic() + patience)
    finally:
        end_group(process, patience=_GRACE)
        process.stdout.close()
    if not ended:
        raise NoAnswerError(
            f"{where}: {words[0]} did not end within {patience:g} s; does the implementation hang? Output: "
            f"{_shown(output.decode(errors='replace'))}"
        )
    return process.wait(), output.decode(errors="replace")


def _read_all(process: subprocess.Popen[bytes], output: bytearray, deadline: float) -> bool:
    """Collect the output until the command ends; whether it did so in time."""
    assert process.stdout is not None
    descriptor = process.stdout.fileno()
    waiting = select.poll()
    waiting.register(descriptor, select.POLLIN)
    while True:
        if waiting.poll(20):
            data = os.read(descriptor, 1 << 16)
            if len(output) < MOST_OUTPUT:
                output += data[: MOST_OUTPUT - len(output)]
            if not data:
                try:
                    process.wait(max(0.01, deadline - time.monotonic()))
                except subprocess.TimeoutExpired:
                    return False
                return True
        elif process.poll() is not None:
            # Something that it started still has its output; it will not say what we wait for.
            return True
        if time.monotonic() > deadline:
            return False


def _shown(output: str) -> str:
    text = output.strip()
    return printable(text if len(text) <= 300 else f"{text[:300]}...") or "nothing"
