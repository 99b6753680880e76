"""Published Tables 1 to 7 as printed, and values recomputed from them.

M. Gautier, A. Janot, A. Jubien, P.-O. Vandanjon, "Joint stiffness identification from only motor force/torque data",
CDC 2011. `errata` lists inconsistencies.

`Decimal` keeps printed digits (0.80 is not 0.8) and exact differences. Parameters have the names of `models.joints`;
the paper's Fv12, the damping between the masses, is F12.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from importlib.resources import files
from types import MappingProxyType
from typing import Any, TypeAlias

from jointid import FlexibleJoint, RigidJoint
from jointid.common.document import Table
from jointid.common.text import number

PrintedRows: TypeAlias = Mapping[str, tuple[Decimal, ...]]
Cell: TypeAlias = tuple[str, str]
"""The column and the parameter of a printed number."""

_JOINTS = (RigidJoint("prismatic"), FlexibleJoint("prismatic"))

SYMBOLS: Mapping[str, str] = MappingProxyType({p.name: p.symbol for joint in _JOINTS for p in joint.parameters})
"""The symbol of every parameter, as the tables below spell it."""

_NAMES = {symbol: name for name, symbol in SYMBOLS.items()}


@dataclass(frozen=True, slots=True, eq=False)
class PublishedTable:
    """One table of the paper.

    Attributes:
        columns: names of the numbers in a row: value, two_sigma and relative_percent (100 sigma / value) in Tables 1
            to 5; a method in Table 6; a test in Table 7.
        rows: by parameter, one number per column; kg, N s/m, N, N/m in Tables 1 to 6, % in Table 7.
        frequency: Hz, the natural frequency under the table.
        residual_percent: of the inverse model, ``||Y - W chi|| / ||Y||``.
        simulated_percent: of the simulation, ``||Y - Ys|| / ||Y||``.
        sums: of motor and load side, by the names of the rigid joint.
        iterations: number stated in the paper, by the place of the statement.
    """

    number: int
    caption: str
    columns: tuple[str, ...]
    rows: PrintedRows
    frequency: Decimal | None = None
    residual_percent: Decimal | None = None
    simulated_percent: Decimal | None = None
    sums: Mapping[str, Decimal] = field(default_factory=dict)
    iterations: Mapping[str, int] = field(default_factory=dict)

    def column(self, name: str) -> dict[str, Decimal]:
        """Return one column, by parameter."""
        place = self.columns.index(name)
        return {parameter: numbers[place] for parameter, numbers in self.rows.items()}

    @property
    def values(self) -> dict[str, float]:
        """The identified values, ready for `models.joints` (Tables 1 to 5)."""
        return {parameter: float(value) for parameter, value in self.column("value").items()}


def _read_table(stated: dict[str, Any]) -> PublishedTable:
    rows = (line.split() for line in stated["rows"].splitlines())
    decimals = ("frequency", "residual_percent", "simulated_percent")
    read = {
        "columns": tuple(stated["columns"]),
        "rows": MappingProxyType({_NAMES[symbol]: tuple(map(Decimal, printed)) for symbol, *printed in rows}),
        "sums": MappingProxyType({name: Decimal(printed) for name, printed in stated.get("sums", {}).items()}),
    }
    return PublishedTable(**{**stated, **read, **{key: Decimal(stated[key]) for key in decimals if key in stated}})


TABLES: Mapping[int, PublishedTable] = MappingProxyType(
    {
        stated["number"]: _read_table(stated)
        for stated in tomllib.loads(files("jointid.paper").joinpath("tables.toml").read_text(encoding="utf-8"))["table"]
    }
)
"""The tables of the paper, by number."""

DENOMINATORS: Mapping[str, str] = MappingProxyType({"DIDIM": "by (15)", "IDIM": "by the IDIM value"})
"""Denominators of the errors of Table 7, and their names in reports."""

METHODS = MappingProxyType({"IDIM": (TABLES[2], TABLES[4]), "DIDIM": (TABLES[3], TABLES[5])})
"""The first and the second test of each method."""

_UNITS = {p.name: joint.unit(p) for joint in _JOINTS for p in joint.parameters}


def sum_sides(values: Mapping[str, float]) -> dict[str, float]:
    """Total inertia, viscous and Coulomb friction."""
    found = FlexibleJoint.rigid_sums({"offset": 0.0, **values})
    return {name: found[name] for name in ("inertia", "viscous", "coulomb")}


def compute_variations(before: PublishedTable, after: PublishedTable) -> dict[str, Decimal]:
    """Exact changes from Table 2 to 4, or 3 to 5."""
    start, end = before.column("value"), after.column("value")
    return {name: end[name] - start[name] for name in start}


def compute_relative_errors(idim: PublishedTable, didim: PublishedTable, way: str = "DIDIM") -> dict[str, Decimal]:
    """Column of Table 7 in %: by (15), relative to DIDIM/IDIM."""
    of = (didim if way == "DIDIM" else idim).column("value")
    return {name: 100 * abs(change / of[name]) for name, change in compute_variations(idim, didim).items()}


def recompute_cells(table: PublishedTable) -> dict[Cell, tuple[Decimal, ...]]:
    """Cells recomputed from printed numbers; in Table 7 one value per denominator."""
    columns: dict[str, list[dict[str, Decimal]]]
    if table.number == 6:
        columns = {method: [compute_variations(*METHODS[method])] for method in table.columns}
    elif table.number == 7:
        columns = {
            heading: [compute_relative_errors(idim, didim, way) for way in DENOMINATORS]
            for heading, idim, didim in zip(table.columns, METHODS["IDIM"], METHODS["DIDIM"], strict=True)
        }
    else:
        percent = {name: 50 * two_sigma / abs(value) for name, (value, two_sigma, _) in table.rows.items()}
        columns = {"relative_percent": [percent]}
    return {
        (heading, name): tuple(column[name] for column in found)
        for heading, found in columns.items()
        for name in table.rows
    }


def format_as_print(value: Decimal) -> str:
    """Format a number as the tables do: 0.80, 8.0e5."""
    exponent = value.as_tuple().exponent
    assert isinstance(exponent, int)
    return f"{value:f}" if exponent <= 0 else f"{value.scaleb(-exponent - 1)}e{exponent + 1}"


def compare_table(
    table: PublishedTable, run: tuple[str, ...] = (), cells: Mapping[str, tuple[str, ...]] = MappingProxyType({})
) -> Table:
    """Table as printed, with recomputed values and the cells of a run."""
    found = recompute_cells(table)
    printed, recomputed = table.columns, table.columns
    if table.number == 6:
        texts = {name: _format_cells(found[method, name][0] for method in printed) for name in table.rows}
    elif table.number == 7:
        recomputed = tuple(f"{test}, {words}" for words in DENOMINATORS.values() for test in printed)
        texts = {
            name: tuple(
                number(float(found[test, name][way]), 3) for way in range(len(DENOMINATORS)) for test in printed
            )
            for name in table.rows
        }
    else:
        printed, recomputed = ("value", "2 sigma", "%"), ("value", "%")
        texts = {name: ("-", number(float(found["relative_percent", name][0]), 3)) for name in table.rows}
    units = dict.fromkeys(table.rows, "%") if table.number == 7 else _UNITS
    rows = [
        (name, f"{SYMBOLS[name]} ({units[name]})", *_format_cells(numbers), *texts[name])
        for name, numbers in table.rows.items()
    ]
    columns = {"printed": printed, "recomputed": recomputed, "this run": run}
    header = tuple(f"{whose} {text}" for whose, headings in columns.items() for text in headings)
    rows = [(*row, *cells.get(name, ("-",) * len(run))) for name, *row in (*rows, *_list_notes_below(table))]
    return Table(("", *header), tuple(rows), table.caption)


def _list_notes_below(table: PublishedTable) -> list[tuple[str, ...]]:
    """Rows printed under Tables 2 to 5: frequency, sums and residuals."""
    rows = []
    if table.frequency is not None:
        for name, hertz in FlexibleJoint.frequencies(table.values).items():
            printed = format_as_print(table.frequency) if name == "free_free" else "-"
            rows.append((name, f"{name.replace('_', '-')} frequency (Hz)", printed, f"{hertz:.2f}"))
        for name, value in sum_sides(table.values).items():
            label = f"{SYMBOLS[name]}1 + {SYMBOLS[name]}2 ({_UNITS[name]})"
            rows.append((name, label, format_as_print(table.sums[name]), f"{value:.1f}"))
    if table.residual_percent is not None:
        rows.append(("residual", "||Y - W chi|| / ||Y|| (%)", format_as_print(table.residual_percent), "-"))
    if table.simulated_percent is not None:
        rows.append(("simulated", "||Y - Ys|| / ||Y|| (%)", format_as_print(table.simulated_percent), "-"))
    return [(name, label, printed, "-", "-", recomputed, "-") for name, label, printed, recomputed in rows]


def _format_cells(cells: Iterable[Decimal]) -> tuple[str, ...]:
    return tuple(map(format_as_print, cells))
