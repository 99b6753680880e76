"""The published numbers, what follows from them, and the list of errata: every value that print alone decides."""

import math
from decimal import ROUND_DOWN, Decimal

import pytest

from jointid.models.joints import FlexibleJoint
from jointid.paper.tables import (
    METHODS,
    SYMBOLS,
    TABLES,
    PublishedTable,
    compare_table,
    compute_relative_errors,
    compute_variations,
    format_as_print,
    recompute_cells,
    sum_sides,
)


def find_misprints(table: PublishedTable) -> set[tuple[str, str]]:
    """Cells that do not follow from other printed numbers by any denominator, neither rounded, cut nor made whole."""
    return {
        (column, SYMBOLS[name])
        for (column, name), candidates in recompute_cells(table).items()
        if not any(is_printed(table.column(column)[name], candidate) for candidate in candidates)
    }


def is_printed(printed: Decimal, recomputed: Decimal) -> bool:
    if printed in (recomputed.quantize(printed), recomputed.quantize(printed, ROUND_DOWN)):
        return True
    whole = printed.to_integral_value()
    return whole == printed == recomputed.quantize(whole)


def by_symbol(column: dict[str, Decimal]) -> dict[str, float]:
    return {SYMBOLS[name]: float(value) for name, value in column.items()}


@pytest.mark.parametrize(
    ("table", "symbol", "printed"),
    [
        (1, "ZZ", "106 0.44 0.21"),
        (2, "F12", "126.0 36.0 14.3"),
        (3, "Fv1", "127.0 1.86 0.73"),
        (4, "ZZ1", "70.1 0.22 0.15"),
        (5, "F12", "50.0 20.00 20.0"),
        (6, "ZZ2", "9.8 10.2"),
        (6, "K12", "0.1e5 -0.1e5"),
        (7, "K12", "1.28 0.0"),
    ],
)
def test_rows_are_as_printed_to_the_last_zero(table: int, symbol: str, printed: str) -> None:
    (name,) = [name for name in TABLES[table].rows if SYMBOLS[name] == symbol]
    assert " ".join(map(format_as_print, TABLES[table].rows[name])) == printed


def test_frequencies_and_that_print_cuts_the_free_free_one() -> None:
    found = {
        n: {name: round(f, 2) for name, f in FlexibleJoint.frequencies(TABLES[n].values).items()} for n in (2, 3, 4, 5)
    }
    assert {n: list(f.values()) for n, f in found.items()} == {
        2: [29.51, 24.13, 16.99],
        3: [29.54, 24.04, 17.17],
        4: [27.53, 21.48, 17.21],
        5: [27.53, 21.32, 17.41],
    }
    for n, each in found.items():
        assert list(each) == ["free_free", "motor_locked", "load_locked"]
        assert TABLES[n].frequency == math.floor(each["free_free"])
        assert str(TABLES[n].frequency) != f"{each['free_free']:.1f}"


def test_table_6_differs_from_tables_2_to_5_in_five_cells() -> None:
    found = {method: by_symbol(compute_variations(*METHODS[method])) for method in TABLES[6].columns}
    assert found == {
        "IDIM": {"ZZ1": -0.1, "Fv1": 3, "Fc1": 0, "K12": 0.2e5, "F12": 84, "ZZ2": 10.2, "Fv2": 0, "Fc2": -0.4},
        "DIDIM": {"ZZ1": -1.1, "Fv1": 1, "Fc1": 1, "K12": 0.1e5, "F12": -86, "ZZ2": 10.2, "Fv2": 4, "Fc2": 0},
    }
    printed = {method: by_symbol(TABLES[6].column(method)) for method in TABLES[6].columns}
    differ = {(m, s): printed[m][s] for m in found for s in found[m] if printed[m][s] != found[m][s]}
    assert differ == {
        ("IDIM", "ZZ1"): -0.2,
        ("IDIM", "K12"): 0.1e5,
        ("IDIM", "ZZ2"): 9.8,
        ("DIDIM", "Fc1"): -1.0,
        ("DIDIM", "K12"): -0.1e5,
    }
    assert find_misprints(TABLES[6]) == set(differ)


def test_table_7_by_both_denominators() -> None:
    by_15 = [by_symbol(compute_relative_errors(*test)) for test in zip(*METHODS.values(), strict=True)]
    by_idim = [by_symbol(compute_relative_errors(*test, "IDIM")) for test in zip(*METHODS.values(), strict=True)]
    assert [{s: round(e[s], 1) for s in ("Fv1", "Fv2", "F12")} for e in by_15] == [
        {"Fv1": 27.6, "Fv2": 44.7, "F12": 7.4},
        {"Fv1": 25.8, "Fv2": 37.5, "F12": 320.0},
    ]
    assert [{s: round(e[s], 1) for s in ("Fv1", "Fv2", "F12")} for e in by_idim] == [
        {"Fv1": 38.0, "Fv2": 30.9, "F12": 7.9},
        {"Fv1": 34.7, "Fv2": 27.3, "F12": 76.2},
    ]
    assert (round(by_15[1]["Fc1"], 1), by_idim[1]["Fc1"]) == (9.1, 10.0)
    assert (round(by_15[0]["K12"], 2), round(by_idim[0]["K12"], 2)) == (1.23, 1.25)
    assert (round(by_15[0]["ZZ1"], 2), round(by_idim[0]["ZZ1"], 2)) == (0.86, 0.85)  # 1.0 is printed: a whole percent


def test_cells_that_no_denominator_explains() -> None:
    found = {("first test", "F12"), ("first test", "K12"), ("second test", "Fc1")}
    assert find_misprints(TABLES[7]) == found
    assert [find_misprints(TABLES[n]) for n in (1, 2, 3, 4, 5)] == [set()] * 4 + [{("relative_percent", "ZZ2")}]


def test_every_sum_is_as_printed() -> None:
    for n in (2, 3, 4, 5):
        assert sum_sides(TABLES[n].values) == pytest.approx({k: float(v) for k, v in TABLES[n].sums.items()}, rel=1e-12)


@pytest.mark.parametrize("table", TABLES.values(), ids=lambda table: f"table {table.number}")
def test_a_comparison_has_every_printed_number_and_a_text_per_heading(table: PublishedTable) -> None:
    found = compare_table(table)
    rows = {label.split(" (")[0]: cells for label, *cells in found.rows}
    assert len(rows) == len(found.rows)
    for name, numbers in table.rows.items():
        assert rows[SYMBOLS[name]][: len(numbers)] == list(map(format_as_print, numbers))
    assert {len(row) for row in found.rows} == {len(found.header)}
    printed = len(next(iter(table.rows.values())))
    assert sum(cell != "-" for row in rows.values() for cell in row[printed:]) == sum(
        len(values) for values in recompute_cells(table).values()
    ) + (6 if table.number in (2, 3, 4, 5) else 0)
