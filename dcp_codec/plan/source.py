"""Generated functions: collection of source lines and their compilation.

The decoder, encoder and dissector of a profile are Python source that is generated on first use, as ``dataclasses`` and
construct's compiler do it. Interpreting a plan field by field would be ten times slower (a dissection, which constructs
all fields, three times). No external text gets into the source: names are numbered, and all other objects are in the
namespace of the code.
"""

from __future__ import annotations

import linecache
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any


class Source:
    """Lines of a function under construction and the namespace of the function."""

    def __init__(self, signature: str) -> None:
        self.lines = [f"def {signature}:"]
        self.namespace: dict[str, Any] = {}
        self._depth = 1
        self._names = 0
        self._constants: dict[tuple[str, Any], str] = {}

    def fresh(self, stem: str = "v") -> str:
        """Return a name that is unique in the function."""
        self._names += 1
        return f"{stem}{self._names}"

    def constant(self, stem: str, value: Any, key: Any = None) -> str:
        """Return the name by which the function refers to ``value``; equal keys share one name."""
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
        """Emit a compound statement: ``line`` and the lines added inside the with-block."""
        self.add(line)
        self._depth += 1
        before = len(self.lines)
        yield
        if len(self.lines) == before:
            self.add("pass")
        self._depth -= 1

    def when(self, condition: str, *lines: str) -> None:
        """Append lines that are executed if a condition holds."""
        with self.block(f"if {condition}:"):
            for line in lines:
                self.add(line)

    def compile(self, title: str) -> Any:
        """Return the function. ``title`` names the source in tracebacks and profiles."""
        text = "\n".join(self.lines) + "\n"
        filename = f"<dcp_codec {title}>"
        linecache.cache[filename] = (len(text), None, text.splitlines(keepends=True), filename)
        exec(compile(text, filename, "exec"), self.namespace)  # noqa: S102 - see the module docstring
        return self.namespace[self.lines[0].split()[1].split("(")[0]]
