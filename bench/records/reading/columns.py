"""The columns of a table with their headings, and how an error names them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from bench.errors import InputError
from bench.records.reading.headings import Heading, heading_of
from bench.records.reading.table import Column, Table


@dataclass(frozen=True)
class Columns:
    """A table of which roles are to be found, and the file it is from."""

    table: Table
    source: object

    @cached_property
    def headings(self) -> list[Heading]:
        return [heading_of(column) for column in self.table.columns]

    @cached_property
    def usable(self) -> list[int]:
        """Numbers of the columns that can be taken."""
        return [i for i, column in enumerate(self.table.columns) if not column.flaw]

    def __getitem__(self, i: int) -> Column:
        return self.table.columns[i]

    def have_clocks(self, numbers: Sequence[int]) -> bool:
        """Whether the file gives each of these columns its own times."""
        return all(self[i].times is not None for i in numbers)

    def shown(self, i: int) -> str:
        """A column in an error: ``3 'X (mm)'``, or the name of a variable."""
        text = self.headings[i].text
        if self.table.contents:
            return f"'{text}'"
        return f"{i} '{text}'" if text else f"{i}"

    def listed(self, numbers: Sequence[int]) -> str:
        return ", ".join(self.shown(i) for i in numbers)

    def error(self, remedy: str) -> InputError:
        return InputError("data", self.source, remedy)

    def example(self, time: int | None = None, first: int | None = None, letter: str = "x") -> str:
        """The remedy that always helps: columns= with a time and one other column, as the user may write it."""
        others = [
            i for i in self.usable if i != time and (time is None or self[i].values.size == self[time].values.size)
        ]
        value = first if first is not None else others[-1] if others else 0
        rest = [i for i in others if i != value]
        clock = time if time is not None else rest[0] if rest else None
        if self.usable and self.have_clocks(self.usable):
            return f"columns={letter}:{self._key(value)}"
        if clock is None:
            return f"columns={letter}:{self._key(value)} rate=… (Hz)"
        return f"columns=t:{self._key(clock)},{letter}:{self._key(value)}"

    def _key(self, i: int) -> str:
        return self[i].name if self.table.contents and i < len(self.table.columns) else str(i)
