"""What every file format reads into and writes from: named columns and single numbers, not interpreted."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from dataclasses import Field, dataclass, field
from pathlib import Path
from types import MappingProxyType
from typing import Any, ClassVar, Protocol, runtime_checkable

import numpy as np

from jointid.common.errors import RecordError
from jointid.common.text import short
from jointid.data.record import FloatArray

_QUOTED = 100  # characters of a name
_LISTED = 20  # columns that a message lists; some MAT files have thousands


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """The numbers of one file, by name.

    Attributes:
        columns: name -> values of shape (samples,), in file order, read-only, NaN where the file has no
            number; the columns of one file can differ in length.
        scalars: name -> single number, where the format keeps such (a MAT file's gains, say).
        source: the file's name, for reports and errors.
        clocks: name of a column -> that of its own time column, where the file has several clocks.

    Raises:
        RecordError: a column is not one-dimensional, or holds nothing.
    """

    columns: Mapping[str, FloatArray]
    scalars: Mapping[str, float] = field(default_factory=dict)
    source: str = ""
    clocks: Mapping[str, str] = field(default_factory=dict)

    def __post_init__(self) -> None:
        columns: dict[str, FloatArray] = {}
        for name, values in self.columns.items():
            column = np.array(values, dtype=np.float64)
            if column.ndim != 1 or column.size == 0:
                raise RecordError(f'Column "{name}" has shape {column.shape}; give a non-empty array of one dimension.')
            column.flags.writeable = False
            columns[name] = column
        scalars = {name: float(value) for name, value in self.scalars.items()}
        object.__setattr__(self, "columns", MappingProxyType(columns))
        object.__setattr__(self, "scalars", MappingProxyType(scalars))

    def listed(self, wanted: str) -> str:
        """Return the names of the columns, quoted; of very many, those most like the one that was wanted."""
        names = list(self.columns)
        shown = names if len(names) <= _LISTED else difflib.get_close_matches(wanted, names, _LISTED, cutoff=0.0)
        rest = f" and {len(names) - len(shown)} more" if len(shown) < len(names) else ""
        return (", ".join(f'"{short(name, _QUOTED)}"' for name in shown) or "none") + rest


class Format(Protocol):
    """A file format: a frozen dataclass whose fields are the options of its reader.

    Attributes:
        name: what messages call the format.
        suffixes: the endings of its files, in lower case, with the dot.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def read(self, path: Path) -> Table:
        """Read the whole file.

        Raises:
            RecordError: the file is not of this format, or is damaged.
            OSError: the file cannot be opened.
        """
        ...

    def write(self, path: Path, table: Table) -> None:
        """Write `table` so that `read` gives it back to the last bit.

        Raises:
            RecordError: the format cannot hold this table.
            OSError: the file cannot be written.
        """
        ...


class Block(Protocol):
    """Neighbouring rows of a file, not read until they are asked for."""

    @property
    def rows(self) -> int:
        """How many there are, 1 or more."""
        ...

    def table(self, rows: int | None = None) -> Table:
        """Read them, or the first so many.

        Raises:
            RecordError: a row is damaged; the sentence names its line.
        """
        ...


@runtime_checkable
class Streamed(Protocol):
    """A format whose files can be read from front to back in bounded memory."""

    def blocks(self, path: Path, rows: int) -> Iterator[Block]:
        """Yield so many rows after so many; the last block may have fewer.

        Raises:
            RecordError: the file is not of this format.
            OSError: the file cannot be opened.
        """
        ...
