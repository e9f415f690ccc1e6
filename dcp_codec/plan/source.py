"""Generated functions: collecting source lines and turning them into code.

The decoder, encoder and dissector of a profile are Python source that is generated when they are first used, the way
``dataclasses`` and construct's own compiler do it: a plan interpreted field by field would be ten times slower
(dissecting, which makes a field of everything: three times).
Nothing from outside gets into the source: names are numbered by us, and whatever else the code needs is an object
in its namespace.
"""

from __future__ import annotations

import linecache
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Source:
    """Lines of a function under construction and the namespace that it will run in."""

    def __init__(self, signature: str) -> None:
        self.lines = [f"def {signature}:"]
        self.namespace: dict[str, Any] = {}
        self._depth = 1
        self._names = 0
        self._constants: dict[tuple[str, Any], str] = {}

    def fresh(self, stem: str = "v") -> str:
        """A name that nothing else in the function has."""
        self._names += 1
        return f"{stem}{self._names}"

    def constant(self, stem: str, value: Any, key: Any = None) -> str:
        """The name under which the function reaches ``value``; equal keys share one name."""
        if key is not None and (stem, key) in self._constants:
            return self._constants[stem, key]
        name = self.fresh(f"{stem}_")
        self.namespace[name] = value
        if key is not None:
            self._constants[stem, key] = name
        return name

    def add(self, line: str) -> None:
        """Append one line at the current depth."""
        self.lines.append("    " * self._depth + line)

    @contextmanager
    def block(self, line: str) -> Iterator[None]:
        """A compound statement: ``line`` and what is added inside."""
        self.add(line)
        self._depth += 1
        before = len(self.lines)
        yield
        if len(self.lines) == before:
            self.add("pass")
        self._depth -= 1

    def compile(self, title: str) -> Any:
        """The function. ``title`` names the source in tracebacks and profiles."""
        text = "\n".join(self.lines) + "\n"
        filename = f"<dcp_codec {title}>"
        linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
        exec(compile(text, filename, "exec"), self.namespace)  # noqa: S102 - see the module docstring
        return self.namespace[self.lines[0].split()[1].split("(")[0]]
