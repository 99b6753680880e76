"""The errata of the paper, with every number recomputed from the printed ones."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from decimal import ROUND_DOWN, Decimal

from jointid import Filtering, FlexibleJoint
from jointid.paper.reproduce import Erratum
from jointid.paper.tables import (
    DENOMINATORS,
    SYMBOLS,
    TABLES,
    TESTS,
    Cell,
    PublishedTable,
    compute_variations,
    format_as_print,
    format_digits,
    recompute_cells,
    sum_sides,
)


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

REGRESSOR = (
    ("v1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "v12", "v12", "sign(v12)"),
)
"""The matrix under (5) as printed, in the letters of `models.joints`; its parameters are those of Table 2."""
REGRESSOR_OF_2 = (
    ("a1", "v1", "sign(v1)", "-q2", "-v2", "0", "0", "0"),
    ("0", "0", "0", "q2", "v2", "a12", "v12", "sign(v12)"),
)
"""The regressor of (2), in the letters of `models.joints` and in the order of the parameters of Table 2."""


def agrees(printed: Decimal, recomputed: Decimal | float, rounding: str | None = None) -> bool:
    """Test whether a number rounds to the printed one."""
    return Decimal(recomputed).quantize(printed, rounding) == printed


def _cell(table: PublishedTable, cell: Cell) -> Decimal:
    column, name = cell
    return table.column(column)[name]


def find_misprints(table: PublishedTable) -> tuple[Cell, ...]:
    """Cells that do not follow from other printed numbers by any admissible rounding.

    Rounded or cut to the printed digits, rounded to a whole number where a whole one is printed, by any denominator.
    """
    return tuple(
        (column, name)
        for (column, name), candidates in recompute_cells(table).items()
        if not any(_matches_print(table.column(column)[name], candidate) for candidate in candidates)
    )


def _matches_print(printed: Decimal, recomputed: Decimal) -> bool:
    if agrees(printed, recomputed) or agrees(printed, recomputed, ROUND_DOWN):
        return True
    whole = printed.to_integral_value()
    return whole == printed and agrees(whole, recomputed)


def compute_shifts(before: PublishedTable, after: PublishedTable) -> dict[str, float]:
    """Change of each parameter in standard deviations, for independent tables."""
    one, other = before.column("two_sigma"), after.column("two_sigma")
    return {
        name: 2 * float(change) / math.hypot(one[name], other[name])
        for name, change in compute_variations(before, after).items()
    }


def find_largest_decimation(cutoff: float, sample_rate: float) -> int:
    """Largest decimation factor that a filter at `cutoff` Hz allows."""
    thinned = Filtering(cutoff=cutoff).resolve(1 / sample_rate).decimation
    assert thinned is not None
    return thinned


def compute_stiffness(motor_inertia: float, load_inertia: float, free_free: float) -> float:
    """Return ``K12 = mu (2 pi f)^2``, ``mu = ZZ1 ZZ2 / (ZZ1 + ZZ2)``, f free-free in Hz."""
    reduced = motor_inertia * load_inertia / (motor_inertia + load_inertia)
    return reduced * (2 * math.pi * free_free) ** 2


def stops(before: float, after: float, tolerance: float, *, absolute: bool = True) -> bool:
    """Test the stopping rule under (12); print takes no absolute value."""
    change = (after - before) / before
    return (abs(change) if absolute else change) <= tolerance


def find_wrong_entries() -> tuple[tuple[int, str, str], ...]:
    """Regressor entries that contradict (2): column, printed, correct."""
    return tuple(
        (column, old, new)
        for rows in zip(REGRESSOR, REGRESSOR_OF_2, strict=True)
        for column, (old, new) in enumerate(zip(*rows, strict=True), 1)
        if old != new
    )


_FLEXIBLE = tuple(TABLES[n] for n in (2, 3, 4, 5))


def _join_slash(texts: Iterable[object]) -> str:
    return " / ".join(map(str, texts))


def _list_cells(cells: Mapping[Cell, Decimal]) -> str:
    return ", ".join(f"{SYMBOLS[name]} {format_as_print(value)} ({column})" for (column, name), value in cells.items())


def _check_natural_frequency() -> Erratum:
    each = [FlexibleJoint.frequencies(table.values) for table in _FLEXIBLE]
    words = {"free_free": "free-free", "motor_locked": "motor locked", "load_locked": "load locked"}
    listed = ", ".join(
        f"{text} {_join_slash(f'{hertz[name]:.2f}' for hertz in each)} Hz" for name, text in words.items()
    )
    highest = max(hertz[name] for hertz in each for name in ("motor_locked", "load_locked"))
    said = f"{EXPERIMENT.natural_frequency:g} Hz"
    return Erratum(
        "The natural frequency",
        "Under Tables 2 to 5, and section V.A",
        f"{_join_slash(table.frequency for table in _FLEXIBLE)} Hz under the tables; {said} in the text, confirmed "
        "with the output blocked.",
        f"{listed}. The printed ones are the free-free frequencies cut to whole hertz. With either side held, at most "
        f"{highest:.2f} Hz is left, so a blocked output cannot show {said}.",
        "Reports all three frequencies, each named by its boundary condition.",
    )


def _check_variations() -> Erratum:
    table = TABLES[6]
    found, wrong = recompute_cells(table), find_misprints(table)
    masses = _join_slash(format_as_print(found[method, "load_inertia"][0]) for method in table.columns)
    return Erratum(
        "The variations with the added mass",
        "Table 6",
        f"{_list_cells({cell: _cell(table, cell) for cell in wrong})}.",
        f"{_list_cells({cell: found[cell][0] for cell in wrong})}. The other {len(found) - len(wrong)} of {len(found)} "
        "are as printed.",
        f"Shows the computed ones: the added {EXPERIMENT.added_mass:g} kg are found as {masses} kg by the two methods.",
    )


def _check_relative_errors() -> Erratum:
    table = TABLES[7]
    found = recompute_cells(table)
    names = ("motor_viscous", "load_viscous", "damping", "motor_coulomb", "stiffness", "motor_inertia")

    def list_cells(texts: Mapping[Cell, str]) -> str:
        return ", ".join(
            f"{SYMBOLS[name]} {_join_slash(texts[test, name] for test in table.columns)}" for name in names
        )

    ways = "; ".join(
        f"{words} {list_cells({cell: format_digits(values[way]) for cell, values in found.items()})} %"
        for way, words in enumerate(DENOMINATORS.values())
    )
    first, second = zip(table.columns, ("motor_inertia", "motor_viscous"), strict=True)
    return Erratum(
        "The relative errors and their denominator",
        "Table 7 and equation (15)",
        f"{list_cells({cell: format_as_print(_cell(table, cell)) for cell in found})} %, in the first / second test.",
        f"{ways}. Equation (15) divides by the DIDIM value, most of the table by the IDIM value. "
        f"{_list_cells({cell: _cell(table, cell) for cell in find_misprints(table)})} follow from neither; "
        f"{_list_cells({first: _cell(table, first)})} does only if rounded to a whole percent, as "
        f"{_list_cells({second: _cell(table, second)})} is.",
        "Offers both denominators, labelled.",
    )


def _check_sums() -> Erratum:
    found = [sum_sides(table.values) for table in _FLEXIBLE]
    agreeing = [agrees(t.sums[name], one[name]) for t, one in zip(_FLEXIBLE, found, strict=True) for name in one]
    recomputed = "; ".join(_join_slash(f"{value:.1f}" for value in one.values()) for one in found)
    return Erratum(
        "The sums of both sides",
        "Under Tables 2 to 5",
        f"{'; '.join(_join_slash(table.sums.values()) for table in _FLEXIBLE)} (kg / N s/m / N).",
        f"{recomputed}: {sum(agreeing)} of {len(agreeing)} agree.",
        "Nothing to correct; a test keeps them.",
    )


def _check_relative_deviations() -> Erratum:
    tables = (TABLES[1], *_FLEXIBLE)
    cells = [(_cell(table, cell), found[0]) for table in tables for cell, found in recompute_cells(table).items()]
    ways = [(agrees(*cell), agrees(*cell, ROUND_DOWN)) for cell in cells]
    ((table, cell),) = [(table, cell) for table in tables for cell in find_misprints(table)]
    value, two_sigma, printed = table.rows[cell[1]]
    return Erratum(
        "The relative deviations",
        "Tables 1 to 5, last column",
        f"A relative deviation beside every 2 sigma; {printed} % for {SYMBOLS[cell[1]]} of Table {table.number}.",
        f"Of {len(cells)}, {ways.count((True, True))} follow rounded and cut alike, {ways.count((True, False))} only "
        f"rounded, {ways.count((False, True))} only cut, and {ways.count((False, False))} neither way: 2 sigma = "
        f"{two_sigma} of {value} is {format_digits(recompute_cells(table)[cell][0])} %; {printed} % would need "
        f"2 sigma = {printed * value / 50:.2f}.",
        "Computes the percentage from the deviation.",
    )


def _check_regressor() -> Erratum:
    places, old, new = (" and ".join(map(str, each)) for each in zip(*find_wrong_entries(), strict=True))
    return Erratum(
        "The regressor",
        "Under equation (5)",
        f"Columns {places} are the velocities {old}. Stiffness and damping are called K and B, which in (3) are "
        "matrices, and the regressor D_STD.",
        f"By (2) these columns are the accelerations {new}, and the parameters K12 and F12; (5) says IDM_ST.",
        "Derives the regressor from (2).",
    )


def _check_permutation() -> Erratum:
    moved = [compute_variations(*test) for test in TESTS]
    steps = " and ".join(f"{m['motor_viscous']:+} / {m['load_viscous']:+}" for m in moved)
    sigmas = [abs(compute_shifts(*test)[name]) for test in TESTS for name in ("motor_viscous", "load_viscous")]
    kept = "; ".join(" and ".join(f"{sum_sides(table.values)['viscous']:g}" for table in test) for test in TESTS)
    idim, didim = (table.column("value") for table in TESTS[0])
    return Erratum(
        'The "permuted" frictions',
        "Section V.C",
        "From Table 2 to Table 3 the values of Fv1 and Fv2 are said to be permuted.",
        f"A permutation of Table 2 would be {idim['load_viscous']} and {idim['motor_viscous']}; Table 3 has "
        f"{didim['motor_viscous']} and {didim['load_viscous']}. From IDIM to DIDIM they move by {steps} N s/m: in both "
        f"tests the same way, by {min(sigmas):.0f} to {max(sigmas):.0f} printed standard deviations, with their sum "
        f"kept ({kept}).",
        "Takes it for what torque alone knows badly, and says when two parameters are known only together; "
        "`jointid reproduce` shows their sum.",
    )


def _check_damping_influence() -> Erratum:
    rows = [table.rows["damping"] for table in _FLEXIBLE]
    intervals = _join_slash(f"{value} +- {two_sigma}" for value, two_sigma, _ in rows)
    away = [2 * value / two_sigma for value, two_sigma, _ in rows]
    return Erratum(
        "The influence of the damping",
        "Sections V.C and V.D",
        "F12 is said to have no influence: without it neither the residual nor the other parameters change by 1 %.",
        f"By the printed 2 sigma, {intervals} N s/m, it is {min(away):.1f} to {max(away):.1f} standard deviations from "
        "zero. What leaving it out does takes a measurement.",
        "Keeps F12 and reports its interval; `jointid reproduce` leaves it out and measures what happens.",
    )


def _check_start_values() -> Erratum:
    half = TABLES[1].values["inertia"] / 2
    start = compute_stiffness(half, half, EXPERIMENT.natural_frequency)
    return Erratum(
        "The start of stiffness and damping",
        "Equation (13)",
        "Inertia, viscous and Coulomb friction start at half the rigid values; K12 and F12 are not mentioned.",
        "A free-free frequency f gives K12 = mu (2 pi f)^2 with mu = ZZ1 ZZ2 / (ZZ1 + ZZ2). From Table 1 and "
        f"{EXPERIMENT.natural_frequency:g} Hz that is {start / 1e5:.2f}e5 N/m, where Table 3 ends at "
        f"{format_as_print(TABLES[3].column('value')['stiffness'])}.",
        "Starts K12 there, from a known or guessed frequency; the start of F12 is our own.",
    )


def _check_decimation() -> Erratum:
    cutoff, rate, thinned = EXPERIMENT.flexible_cutoff, EXPERIMENT.sample_rate, EXPERIMENT.decimation
    most = find_largest_decimation(cutoff, rate)
    return Erratum(
        "The decimation",
        "Sections V.A and V.C",
        f"A low-pass at {cutoff:g} Hz, and one sample in {thinned} kept of {rate:g} per second.",
        f"One in {thinned} has its Nyquist frequency at {rate / 2 / thinned:.1f} Hz, below the cut-off. With the usual "
        f"room, cut-off <= 0.8 rate / (2 n), {cutoff:g} Hz allows one in {most}.",
        f"Keeps one in {most}; the printed setting is a preset that warns.",
    )


_TOLERANCE = 0.025  # of the sister papers
_ENDS = {True: "ends the iterations", False: "does not"}
_PARAMETERS = len(TABLES[3].rows)
_SPAN = max(TABLES[2].values.values()) / min(TABLES[2].values.values())
_VISCOUS = sum_sides(TABLES[2].values)["viscous"]
_SIGMAS = [TABLES[3].rows[name][1] / two_sigma for name, (_, two_sigma, _) in TABLES[2].rows.items()]

RECOMPUTED: tuple[Erratum, ...] = (
    _check_natural_frequency(),
    _check_variations(),
    _check_relative_errors(),
    _check_sums(),
    _check_relative_deviations(),
    Erratum(
        "The number of iterations",
        "Table 3, sections V.C, V.D and VI",
        "{caption} in the caption of Table 3; {text} in the text and in the conclusion.".format(**TABLES[3].iterations),
        f"Print cannot decide. Nelder-Mead on {_PARAMETERS} parameters simulates {_PARAMETERS + 1} points before its "
        "first iteration, and an iteration usually moves one of them; fminsearch by default allows 200 iterations and "
        f"200 simulations per parameter, {200 * _PARAMETERS:,} of each.",
        "Counts both, and states cap, tolerances and scaling; `jointid reproduce` measures what it takes.",
    ),
    _check_regressor(),
    Erratum(
        "Two names for the damping",
        "Equation (3) and Tables 2 to 7",
        "Fv12, like a friction; F12 in (2).",
        f"It acts between the masses and is part of no friction sum: Fv1 + Fv2 of Table 2 is {_VISCOUS:g} N s/m, as "
        f"printed, and would be {_VISCOUS + TABLES[2].values['damping']:g} with it.",
        "Calls it F12 and never adds it to a friction.",
    ),
    Erratum(
        "The stop rule",
        "Under equation (12)",
        "(new norm - old norm) / old norm <= tolerance, without an absolute value.",
        f"So any decrease stops: at a tolerance of {100 * _TOLERANCE:g} %, halving the residual "
        f"{_ENDS[stops(2.0, 1.0, _TOLERANCE, absolute=False)]}; with the absolute value it "
        f"{_ENDS[stops(2.0, 1.0, _TOLERANCE)]}.",
        f"Takes the absolute value. The sister papers use {100 * _TOLERANCE:g} %, on the residual and on the "
        "parameters, and at most 10 iterations.",
    ),
    _check_start_values(),
    _check_decimation(),
    Erratum(
        "The condition number",
        "Section V.A",
        f"cond(W) = {EXPERIMENT.condition_number:g}.",
        "Of which W is not said: raw, columns normalised, or columns scaled by the parameters. The parameters of Table "
        f"2 span a factor of {_SPAN:,.0f}, and by up to as much the first and the last may differ.",
        "Reports all three, named; `jointid reproduce` measures them.",
    ),
    _check_permutation(),
    _check_damping_influence(),
    Erratum(
        "The standard deviations of DIDIM",
        "Table 3 and section V.C",
        "Slightly different from those of IDIM, because the regressor is simulated and free of noise.",
        f"They are {min(_SIGMAS):.2f} to {max(_SIGMAS):.2f} of those of Table 2, although one signal is used and not "
        "three. What torque alone can know, and how often such intervals cover the truth, takes a measurement.",
        "Takes the covariance from the output sensitivities; the paper's formula serves in paper mode only, labelled.",
    ),
)
