"""The finding on the paper's intervals, over 1,000 runs; its seeds are fixed once and never retuned."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from jointid.paper.coverage import Coverage, coverage
from jointid.paper.published import SYMBOLS

RUNS = 1000


@pytest.fixture(scope="module")
def found() -> Coverage:
    return coverage(RUNS)


@pytest.mark.slow
def test_the_paper_s_intervals_miss_the_frictions_and_those_of_the_sensitivities_hold(found: Coverage) -> None:
    for name in ("motor_viscous", "load_viscous"):
        assert found.inverse_model[name] < 0.5
        assert 0.93 <= found.sensitivities[name] <= 0.975
    for name, share in found.sensitivities.items():
        assert 0.92 <= share <= 0.98, name
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        assert 0.93 <= found.sensitivities[name] <= 0.975, name


@pytest.mark.slow
def test_the_estimates_are_unbiased_and_as_sharp_as_they_can_be(found: Coverage) -> None:
    assert all(abs(bias) <= 0.2 for bias in found.bias.values())
    assert found.spread["stiffness"] <= 0.004
    assert found.spread["motor_inertia"] <= 0.004
    assert found.spread["motor_viscous"] > 0.05  # torque alone does not tell it from the load's


@pytest.mark.slow
def test_the_docs_show_these_numbers(found: Coverage) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    rows = {
        symbol: (int(a), int(b)) for symbol, a, b in re.findall(r"^\| (\w+) \| (\d+) \| (\d+) \|", page, re.MULTILINE)
    }
    for name, share in found.sensitivities.items():
        paper, honest = rows[SYMBOLS.get(name, name)]
        assert abs(paper - 100 * found.inverse_model[name]) <= 1.0, name
        assert abs(honest - 100 * share) <= 1.0, name
