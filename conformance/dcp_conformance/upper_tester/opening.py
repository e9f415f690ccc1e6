"""Upper testers as people name them on a command line."""

from __future__ import annotations

import functools
import re
from pathlib import Path

from dcp_conformance.errors import UsageError

from .base import Reconnecting
from .channels import ProcessChannel, SocketChannel
from .stream import StreamUpperTester

#: The forms that :func:`open_upper` accepts, for help texts.
FORMS = {
    "unix:PATH": "JSON-RPC lines over a Unix socket",
    "tcp:HOST:PORT": "the same over TCP",
    "exec:COMMAND": "the same over standard input and output of a program that is started",
    "commands:FILE.toml": "command lines instead of methods; built in: commands:cpp-tools",
}
#: Octets that the address of a Unix socket has room for.
_LONGEST_PATH = 107


def open_upper(spec: str, patience: float = 5.0, *, starting: bool = True) -> Reconnecting:
    """Open the upper tester that ``spec`` names (:data:`FORMS`); ``patience``: timeout of each answer, s.

    ``starting`` False: no process is about to open the socket, so that a refused connection is an error at once. After
    a connection was lost, the tester waits in any case.

    Raises ``UsageError`` for a text that names none, ``UpperTesterError`` if it cannot be reached or does not keep to
    the contract.
    """
    kind, colon, rest = spec.partition(":")
    if not colon or kind not in ("unix", "tcp", "exec", "commands") or not rest.strip():
        forms = "\n".join(f"  {form}  {about}" for form, about in FORMS.items())
        raise UsageError(f"{spec!r} is not an upper tester; expected one of\n{forms}")
    if kind == "commands":
        from .commands import open_commands

        return open_commands(rest, patience)
    if kind == "exec":
        # The timeout is for answers: a program starts at once, or not at all.
        return StreamUpperTester(spec, lambda _: ProcessChannel(spec, rest), patience, several=False)
    address = _tcp_address(spec, rest) if kind == "tcp" else _path(spec, rest)
    connect = functools.partial(SocketChannel, spec, address)
    return StreamUpperTester(spec, connect, patience, connecting=patience if starting else 0)


def _path(spec: str, path: str) -> str:
    if len(path.encode()) > _LONGEST_PATH:
        raise UsageError(f"{spec}: a Unix socket has at most {_LONGEST_PATH} octets in its path; use a shorter one")
    if not Path(path).parent.is_dir():
        raise UsageError(f"{spec}: there is no directory {Path(path).parent}")
    return path


def _tcp_address(spec: str, text: str) -> tuple[str, int]:
    match = re.fullmatch(r"(?:\[([^\]]+)\]|([^:]+)):(\d{1,5})", text)
    if match is None or not 1 <= int(match[3]) <= 0xFFFF:
        raise UsageError(
            f"{spec}: not an address; expected tcp:HOST:PORT, such as tcp:127.0.0.1:4711 or tcp:[::1]:4711"
        )
    return match[1] or match[2], int(match[3])
