"""MATLAB's MAT files: versions 4 to 7, and version 7.3, which is HDF5 within; the first bytes tell which."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar, Literal

from jointid.common.arrays import FloatArray
from jointid.common.errors import RecordError
from jointid.records.formats import h5, matlab73
from jointid.records.formats.matfile import read_arrays
from jointid.records.formats.table import Holds, NotStreamedError, Table

_NAME = re.compile(r"[A-Za-z]\w{0,62}", re.ASCII)
_LONGEST = 63
_KEYWORD = re.compile(
    "break|case|catch|classdef|continue|else|elseif|end|for|function|global|if|otherwise|parfor|persistent|"
    "return|spmd|switch|try|while"
)


@dataclass(frozen=True, slots=True)
class Matlab:
    """MAT files: vectors are columns, 1 x 1 arrays scalars; a structure's field is called "structure.field".

    A matrix gives the columns "name[0]", "name[1]", ...; its samples run along the longer side. What is not a
    real number (text, cells, objects, complex arrays) is passed over.

    Attributes:
        version: of what is written, "7" or "7.3"; a file is read whichever it has.

    Raises:
        RecordError: there is no such version.
    """

    version: Literal["7", "7.3"] = "7"

    name: ClassVar[str] = "MAT"
    suffixes: ClassVar[tuple[str, ...]] = (".mat",)
    holds: ClassVar[Holds] = Holds.SCALARS | Holds.LENGTHS

    def __post_init__(self) -> None:
        if self.version not in ("7", "7.3"):
            raise RecordError(f'A MAT file is written in version "7" or "7.3"; got {self.version!r}.')

    def read(self, path: Path) -> Table:
        """Read every numeric variable of the file; see `Format.read`."""
        if _is_hdf5(path):
            return matlab73.read(path)
        found = _read_arrays(path)
        scalars = {name: float(array.item()) for name, array in found if array.size == 1}
        columns = dict(column for name, array in found if array.size > 1 for column in _split_columns(name, array))
        if not (columns or scalars):
            raise RecordError(f"{path.name} holds no array of real numbers; save the signals as numeric variables.")
        return Table(columns, scalars, path.name)

    def write(self, path: Path, table: Table) -> None:
        """Write columns as n x 1, scalars as 1 x 1 variables; a column of one sample is read as a scalar."""
        variables: dict[str, Any] = {**table.columns, **table.scalars}
        refused = [n for n in variables if not _NAME.fullmatch(n) or _KEYWORD.fullmatch(n)]
        if refused:
            raise RecordError(
                f"{_quote(refused)} cannot name a MATLAB variable (a letter, then letters, digits and _, at "
                "most 63 in all, no keyword); rename the columns, or write a .csv file."
            )
        twice = [n for n in table.scalars if n in table.columns]
        if twice:
            raise RecordError(f"{_quote(twice)} names a column and a scalar; a MAT file holds one variable per name.")
        if self.version == "7.3":
            matlab73.write(path, table)
            return
        from scipy.io import savemat

        # Compressed variables carry a checksum: a damaged file is noticed, not read as other numbers.
        savemat(path, variables, do_compression=True, oned_as="column")

    def blocks(self, path: Path, rows: int) -> Iterator[h5.Rows]:
        """Yield so many rows after so many, of version 7.3."""
        if not _is_hdf5(path):
            raise NotStreamedError(
                f"{path.name} is a MAT file of version 7 or older, which cannot be read in chunks; save it with -v7.3 "
                "in MATLAB, or convert it."
            )
        yield from matlab73.blocks(path, rows)

    def legal_name(self, name: str, others: Collection[str] = ()) -> str:
        """Return a name as that of a variable; see `Format.legal_name`."""
        plain = re.sub(r"\W+", "_", name, flags=re.ASCII).strip("_") or "column"
        plain = plain if plain[0].isalpha() and not _KEYWORD.fullmatch(plain) else f"x{plain}"
        return name if _NAME.fullmatch(name) and not _KEYWORD.fullmatch(name) else plain[:_LONGEST]


def _is_hdf5(path: Path) -> bool:
    """True if a file is of version 7.3."""
    with path.open("rb") as file:
        head = file.read(matlab73.HEADER + len(h5.SIGNATURE))
    return any(head.startswith(h5.SIGNATURE, offset) for offset in (0, matlab73.HEADER))


def _read_arrays(path: Path) -> list[tuple[str, FloatArray]]:
    """Return every matrix of real numbers and its path; any damage is one `RecordError`."""
    try:
        return list(read_arrays(path.read_bytes()))
    except (ValueError, RecursionError, MemoryError) as error:
        raise RecordError(
            f"{path.name} cannot be read as a MAT file: it is damaged, cut off or of another format; "
            "save it again with -v7 in MATLAB."
        ) from error


def _split_columns(name: str, array: FloatArray) -> Iterator[tuple[str, FloatArray]]:
    """Yield a vector as one column, a matrix as one column per signal."""
    if 1 in array.shape:
        yield name, array.ravel()
        return
    samples_first = array if array.shape[0] >= array.shape[1] else array.T
    for index, column in enumerate(samples_first.T):
        yield f"{name}[{index}]", column


def _quote(names: list[str]) -> str:
    return ", ".join(f'"{name}"' for name in names)
