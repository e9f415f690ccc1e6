"""Logs to standard error, one event per line: ``key=value`` for people and grep, or JSON for collectors."""

from __future__ import annotations

import json
import logging
import re
import sys
import time
from typing import Any, Final, Literal, TextIO

from dcp_codec.common.printable import plain

LogFormat = Literal["text", "json"]

_BARE: Final = re.compile(r"[\w./:@%+-]+")


class _Formatter(logging.Formatter):
    """Formats time, level, logger and event, followed by the fields in ``extra={"fields": {...}}`` of the call."""

    def __init__(self, form: LogFormat) -> None:
        super().__init__()
        self._json = form == "json"

    def format(self, record: logging.LogRecord) -> str:
        stamp = time.strftime("%Y-%m-%dT%H:%M:%S", time.gmtime(record.created)) + f".{int(record.msecs):03d}Z"
        shown: dict[str, Any] = {
            "time": stamp,
            "level": record.levelname.lower(),
            "logger": record.name,
            "event": record.getMessage(),
            **getattr(record, "fields", {}),
        }
        if record.exc_info:
            shown["trace"] = self.formatException(record.exc_info)
        if self._json:
            return json.dumps(shown, default=str)
        return " ".join(f"{name}={_quoted(value)}" for name, value in shown.items())


def _quoted(value: Any) -> str:
    text = str(value)
    # Quoted if necessary, so that an event is always one line.
    return text if _BARE.fullmatch(text) else plain(json.dumps(text, ensure_ascii=False))


def set_up(level: str, form: LogFormat, stream: TextIO | None = None) -> None:
    """Write the log of this process to ``stream``, by default standard error."""
    handler = logging.StreamHandler(stream or sys.stderr)
    handler.setFormatter(_Formatter(form))
    root = logging.getLogger()
    root.handlers[:] = [handler]
    root.setLevel(level.upper())
    # If the log cannot be written any more, logging must not report that, too.
    logging.raiseExceptions = False
