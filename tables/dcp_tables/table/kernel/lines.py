"""Source of the columnar decoder, line by line: reading numbers, filling columns, numbering identifiers.

All integers are ``int64``: an unsigned number of eight octets is represented by its bit pattern, and a length with the
highest bit set is too long. Indices of arrays are unsigned, so that Numba does not check for negative indices.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from dcp_codec.plan.source import Source
from dcp_codec.plan.tree import Scalar

from .row_buffer import item
from .shape import Column

#: Reasons why the function returns: all frames are decoded, a table is full, or a pool of identifiers is full.
DONE, FULL, POOL_FULL = 0, 2, 3

#: Odd multiplier of the hash that distributes identifiers to the slots of a pool.
_MULTIPLIER = 0x9E3779B97F4A7C1
#: Maximum size in octets of an identifier that is used as its own key.
SHORT = 8


class KernelLines(Source):
    """Source lines of the function, with methods that append statements for reading values and filling columns.

    A failure is a ``break`` of the innermost loop, so that all statements that may fail must be in a loop.
    """

    def fail_if(self, condition: str) -> None:
        """Append a statement that leaves the innermost loop, with ``bad_now`` still set, if ``condition`` is true."""
        self.when(condition, "break")

    @contextmanager
    def loop(self, line: str) -> Iterator[None]:
        """Append a loop whose body may fail; the variable ``ok`` is false while an element is read."""
        ok = self.fresh("ok")
        self.add(f"{ok} = True")
        with self.block(line):
            self.add(f"{ok} = False")
            yield
            self.add(f"{ok} = True")
        self.fail_if(f"not {ok}")

    # -- values ---------------------------------------------------------------------------------------------

    @staticmethod
    def octet(at: str, relative: int) -> str:
        """Return the expression of the octet at ``at + relative``."""
        return f"I64(b[U64({at} + {relative})])" if relative else f"I64(b[U64({at})])"

    def number(self, scalar: Scalar, at: str, relative: int) -> str:
        """Return the expression of an integer, or of the bit pattern of a float, at ``at + relative``."""
        size = scalar.size
        order = range(size) if scalar.order == "little" else range(size - 1, -1, -1)
        parts = [
            self.octet(at, relative + place) + (f" << {8 * rank}" if rank else "") for rank, place in enumerate(order)
        ]
        text = " | ".join(f"({part})" for part in parts) if size > 1 else parts[0]
        if size == 8:
            text = f"wrapped({text})"
        if scalar.signed and size < 8:
            sign = 1 << (8 * size - 1)
            text = f"((({text}) ^ {sign}) - {sign})"
        return text

    def put(self, column: Column | None, row: str, value: str) -> None:
        """Append the assignment of a number to a column; nothing if ``column`` is None."""
        if column is not None:
            self.add(f"{self.place(column, row)} = {value}")

    @staticmethod
    def place(column: Column, row: str) -> str:
        """Return the expression of a column's value in a row of the stage; for variable lengths the end offset."""
        return f"{item(column)}[U64(at{column.number} + {row})]"

    def put_octets(self, column: Column, row: str, at: str, size: int) -> None:
        """Append statements that copy ``size`` octets into a column of octets."""
        place = self.fresh("q")
        self.add(f"{place} = at{column.number} + {row} * {size}")
        if size <= SHORT:
            for index in range(size):
                self.add(f"u1[U64({place} + {index})] = b[U64({at} + {index})]")
        else:
            step = self.fresh("i")
            with self.block(f"for {step} in range({size}):"):
                self.add(f"u1[U64({place} + {step})] = b[U64({at} + {step})]")

    def put_varying(self, column: Column, row: str, at: str, size: str) -> None:
        """Append statements that add ``size`` octets to a column of variable length."""
        number, index = column.number, self.fresh("i")
        with self.block(f"for {index} in range({size}):"):
            self.add(f"d{number}[U64(m{number} + {index})] = b[U64({at} + {index})]")
        self.add(f"m{number} += {size}")
        self.put(column, row, f"m{number}")

    def intern(self, pool: str, at: str, size: int, target: str) -> None:
        """Append statements that set ``target`` to the number of an identifier of ``size`` <= 8 octets in a pool."""
        key, place = self.fresh("k"), self.fresh("h")
        self.add(f"{key} = {self.number(Scalar('', 'int', size, '', 'big'), at, 0)}")
        self.add(f"{place} = ((({key} ^ ({key} >> 29)) * {_MULTIPLIER}) >> 20) & {pool}_mask")
        with self.block("while True:"):
            self.add(f"{target} = I64({pool}_slots[U64({place})])")
            with self.block(f"if {target} < 0:"):
                self.when(f"{pool}_many >= {pool}_most", f"bad_now = {POOL_FULL}", "break")
                self.add(f"{target} = {pool}_many")
                self.add(f"{pool}_slots[U64({place})] = {target}")
                self.add(f"{pool}_keys[U64({target})] = {key}")
                self.add(f"{pool}_many += 1")
                self.add("break")
            self.when(f"{pool}_keys[U64({target})] == {key}", "break")
            self.add(f"{place} = ({place} + 1) & {pool}_mask")
        self.fail_if(f"bad_now == {POOL_FULL}")

    def intern_any(self, at: str, size: str, target: str) -> None:
        """Append the statements of :meth:`intern` for node identifiers of any size."""
        self.add(f"{target} = intern(b, {at}, {size}, n_slots, n_ends, n_arena, n_many)")
        self.when(f"{target} < 0", f"bad_now = {POOL_FULL}", "break")
        self.when(f"{target} == n_many", "n_many += 1")

    def node_id(self, at: str, size: int, target: str) -> None:
        """Append statements that set ``target`` to the number of a node identifier of fixed size."""
        if size <= SHORT:
            self.intern("n", at, size, target)
        else:
            self.intern_any(at, f"I64({size})", target)
