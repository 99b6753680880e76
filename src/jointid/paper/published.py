"""Published numbers as printed: Tables 1 to 7 and experiment settings.

M. Gautier, A. Janot, A. Jubien, P.-O. Vandanjon, "Joint stiffness identification from only motor force/torque data",
CDC 2011. `errata` lists inconsistencies.

`Decimal` keeps printed digits (0.80 is not 0.8) and exact differences. Parameters have the names of `models.joints`;
the paper's Fv12, the damping between the masses, is F12.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from importlib.resources import files
from types import MappingProxyType
from typing import Any, TypeAlias

from jointid import FlexibleJoint, RigidJoint

PrintedRows: TypeAlias = Mapping[str, tuple[Decimal, ...]]
Cell: TypeAlias = tuple[str, str]
"""The column and the parameter of a printed number."""

SYMBOLS: Mapping[str, str] = MappingProxyType(
    {
        parameter.name: parameter.symbol
        for joint in (RigidJoint("prismatic"), FlexibleJoint("prismatic"))
        for parameter in joint.parameters
    }
)
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

    def cell(self, cell: Cell) -> Decimal:
        """Return one number, by its column and parameter."""
        column, parameter = cell
        return self.rows[parameter][self.columns.index(column)]

    @property
    def values(self) -> dict[str, float]:
        """The identified values, ready for `models.joints` (Tables 1 to 5)."""
        return {parameter: float(value) for parameter, value in self.column("value").items()}


@dataclass(frozen=True, slots=True)
class PublishedSettings:
    """Settings of the experiment, as the text of section V gives them."""

    sample_rate: float = 1000.0  # Hz, V.A
    natural_frequency: float = 30.0  # Hz, stated as confirmed with the output blocked, V.A
    bandwidth: float = 30.0  # Hz, of the position loop, V.A
    condition_number: float = 30.0  # of W, its scaling not stated, V.A
    rigid_cutoff: float = 5.0  # Hz, of the filters for the rigid model, V.B
    flexible_cutoff: float = 60.0  # Hz, of those for the flexible model, V.C
    decimation: int = 12  # one sample in so many is kept, V.C
    added_mass: float = 10.0  # kg, on the load in the second test, V.D


EXPERIMENT = PublishedSettings()


def _read_table(stated: dict[str, Any]) -> PublishedTable:
    rows = (line.split() for line in stated["rows"].splitlines())
    numbers = {
        key: Decimal(stated[key]) for key in ("frequency", "residual_percent", "simulated_percent") if key in stated
    }
    return PublishedTable(
        stated["number"],
        stated["caption"],
        tuple(stated["columns"]),
        MappingProxyType({_NAMES[symbol]: tuple(map(Decimal, printed)) for symbol, *printed in rows}),
        sums=MappingProxyType({name: Decimal(printed) for name, printed in stated.get("sums", {}).items()}),
        iterations=MappingProxyType(stated.get("iterations", {})),
        **numbers,
    )


TABLES: Mapping[int, PublishedTable] = MappingProxyType(
    {
        stated["number"]: _read_table(stated)
        for stated in tomllib.loads(files("jointid.paper").joinpath("tables.toml").read_text(encoding="utf-8"))["table"]
    }
)
"""The tables of the paper, by number."""

REGRESSOR = (
    ("v1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "v12", "v12", "sign(v12)"),
)
"""The matrix under (5) as printed, in the letters of `models.joints`; its parameters are those of Table 2."""
