"""Published numbers as printed: Tables 1 to 7 and experiment settings.

M. Gautier, A. Janot, A. Jubien, P.-O. Vandanjon, "Joint stiffness identification from only motor force/torque data",
CDC 2011. `errata` lists inconsistencies.

`Decimal` keeps printed digits (0.80 is not 0.8) and exact differences. Parameters have the names of `models.joints`;
the paper's Fv12, the damping between the masses, is F12.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from decimal import Decimal
from types import MappingProxyType
from typing import TypeAlias

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
_IDENTIFIED = ("value", "two_sigma", "relative_percent")


@dataclass(frozen=True, slots=True, eq=False)
class PublishedTable:
    """One table of the paper.

    Attributes:
        section: of the paper, that presents it.
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
    section: str
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
    encoder_counts: int = 100_000  # per revolution, V.A
    natural_frequency: float = 30.0  # Hz, stated as confirmed with the output blocked, V.A
    bandwidth: float = 30.0  # Hz, of the position loop, V.A
    condition_number: float = 30.0  # of W, its scaling not stated, V.A
    rigid_cutoff: float = 5.0  # Hz, of the filters for the rigid model, V.B
    flexible_cutoff: float = 60.0  # Hz, of those for the flexible model, V.C
    decimation: int = 12  # one sample in so many is kept, V.C
    butterworth_order: int = 4  # of the filter on the positions, V.C
    added_mass: float = 10.0  # kg, on the load in the second test, V.D


EXPERIMENT = PublishedSettings()


def _parse_rows(text: str) -> PrintedRows:
    """Read lines of a symbol and its numbers."""
    lines = [line.split() for line in text.strip().splitlines()]
    return MappingProxyType({_NAMES[symbol]: tuple(map(Decimal, numbers)) for symbol, *numbers in lines})


def _parse_sums(inertia: str, viscous: str, coulomb: str) -> Mapping[str, Decimal]:
    return MappingProxyType({"inertia": Decimal(inertia), "viscous": Decimal(viscous), "coulomb": Decimal(coulomb)})


_TABLES = (
    PublishedTable(
        number=1,
        section="V.B",
        caption="rigid joint by DIDIM",
        columns=_IDENTIFIED,
        rows=_parse_rows("""
            ZZ   106    0.44  0.21
            Fv   208    3.5   0.84
            Fc   20.0   0.35  0.88
        """),
        iterations=MappingProxyType({"text": 2}),
    ),
    PublishedTable(
        number=2,
        section="V.C",
        caption="flexible joint by IDIM",
        columns=_IDENTIFIED,
        rows=_parse_rows("""
            ZZ1   70.2   0.20   0.14
            Fv1   92.0   1.89   1.03
            Fc1   10.0   0.47   2.35
            K12   8.0e5  3.0e3  0.19
            F12  126.0  36.0   14.3
            ZZ2   34.8   0.19   0.27
            Fv2  110.0   1.69   0.76
            Fc2   10.4   0.15   0.72
        """),
        frequency=Decimal("29.0"),
        residual_percent=Decimal(8),
        simulated_percent=Decimal(8),
        sums=_parse_sums("105", "202", "20.4"),
    ),
    PublishedTable(
        number=3,
        section="V.C",
        caption="flexible joint by DIDIM",
        columns=_IDENTIFIED,
        rows=_parse_rows("""
            ZZ1   69.6   0.18   0.13
            Fv1  127.0   1.86   0.73
            Fc1   10.0   0.45   2.25
            K12   8.1e5  3.0e3  0.18
            F12  136.0  35.0   12.86
            ZZ2   35.5   0.19   0.26
            Fv2   76.0   1.67   1.09
            Fc2   10.0   0.15   0.75
        """),
        frequency=Decimal("29.0"),
        simulated_percent=Decimal(9),
        sums=_parse_sums("105.1", "203", "20.0"),
        iterations=MappingProxyType({"caption": 10, "text": 25, "conclusion": 25}),
    ),
    PublishedTable(
        number=4,
        section="V.D",
        caption="flexible joint by IDIM, 10 kg added to the load",
        columns=_IDENTIFIED,
        rows=_parse_rows("""
            ZZ1   70.1   0.22   0.15
            Fv1   95.0   1.90   1.0
            Fc1   10.0   0.46   2.3
            K12   8.2e5  3.0e3  0.18
            F12  210.0  40.0    9.5
            ZZ2   45.0   0.20   0.22
            Fv2  110.0   1.67   0.76
            Fc2   10.0   0.16   0.80
        """),
        frequency=Decimal("27.0"),
        residual_percent=Decimal(8),
        simulated_percent=Decimal(8),
        sums=_parse_sums("115.1", "205", "20.0"),
    ),
    PublishedTable(
        number=5,
        section="V.D",
        caption="flexible joint by DIDIM, 10 kg added to the load",
        columns=_IDENTIFIED,
        rows=_parse_rows("""
            ZZ1   68.5   0.20   0.14
            Fv1  128.0   1.90   0.74
            Fc1   11.0   0.45   2.0
            K12   8.2e5  3.0e3  0.18
            F12   50.0  20.00  20.0
            ZZ2   45.7   0.18   0.24
            Fv2   80.0   1.67   1.04
            Fc2   10.0   0.15   0.75
        """),
        frequency=Decimal("27.0"),
        simulated_percent=Decimal(9),
        sums=_parse_sums("114.2", "208", "21.0"),
        iterations=MappingProxyType({"text": 25}),
    ),
    PublishedTable(
        number=6,
        section="V.D",
        caption="change of each parameter with the 10 kg",
        columns=("IDIM", "DIDIM"),
        rows=_parse_rows("""
            ZZ1  -0.2    -1.1
            Fv1   3.0     1.0
            Fc1   0.0    -1.0
            K12   0.1e5  -0.1e5
            F12  84.0   -86.0
            ZZ2   9.8    10.2
            Fv2   0.0     4.0
            Fc2  -0.4     0
        """),
    ),
    PublishedTable(
        number=7,
        section="V.C",
        caption="relative errors between IDIM and DIDIM",
        columns=("first test", "second test"),
        rows=_parse_rows("""
            ZZ1   1.0    2.3
            Fv1  38.0   35.0
            Fc1   0.0    0.0
            K12   1.28   0.0
            F12   9.0   76.0
            ZZ2   2.0    1.6
            Fv2  31.0   27.3
            Fc2   4.0    0.0
        """),
    ),
)

TABLES: Mapping[int, PublishedTable] = MappingProxyType({table.number: table for table in _TABLES})
"""The tables of the paper, by number."""

REGRESSOR = (
    ("v1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "v12", "v12", "sign(v12)"),
)
"""The matrix under (5) as printed, in the letters of `models.joints`; its parameters are those of Table 2."""
