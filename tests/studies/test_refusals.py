"""A spring made stiffer until no record shows it: values where they can be known, bounds elsewhere, and both true.

80 runs; their seeds are fixed once and never retuned. `studies.refusals` makes the table of 200 in the docs.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Literal

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.estimation.identify import identify
from jointid.paper.twin import twin
from studies.refusals import FACTORS, Refusals, refusals


@pytest.fixture(scope="module")
def found() -> Refusals:
    return refusals(seeds=range(1, 5))


def test_a_plain_spring_is_given_and_its_prediction_comes_true() -> None:
    (run,) = refusals((1.0,), seeds=(1,), noises=("white",)).runs
    assert run.value is not None
    assert run.std == pytest.approx(run.predicted * run.stiffness, rel=0.2)
    assert run.holds


def test_a_spring_is_not_made_stiffer_by_nothing() -> None:
    with pytest.raises(MethodError, match="positive factor; received 0"):
        twin(stiffer=0.0)


@pytest.mark.statistical
def test_values_and_bounds_are_true_and_given_where_they_should_be(found: Refusals) -> None:
    assert len(found.runs) == 80
    assert found.held >= 0.95
    assert found.refused_plain <= 0.02
    assert found.given_invisible <= 0.02
    given = [run for run in found.runs if run.value is not None]
    refused = [run for run in found.runs if run.value is None]
    assert np.mean([run.holds for run in given]) >= 0.88  # of some 50 intervals of 2 sigma, chance lets 3 more go
    assert np.mean([run.holds for run in refused]) >= 0.95
    assert np.mean([run.bound is not None for run in refused]) >= 0.95  # or it would say nothing


@pytest.mark.statistical
def test_the_verdict_turns_once_from_values_to_bounds(found: Refusals) -> None:
    given = [np.mean([run.value is not None for run in found.runs if run.factor == factor]) for factor in FACTORS]
    assert given == sorted(given, reverse=True)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "noise", "given"), [(50.0, "white", True), (100.0, "disturbance", False)])
def test_a_whole_identification_says_the_same(
    factor: float, noise: Literal["disturbance", "white"], given: bool
) -> None:
    """In the table the fit begins at the truth; here it begins from nothing."""
    axis = twin("L19", noise=noise, seed=1, stiffer=factor)
    estimate = identify(axis.record.without("motor_position", "load_position"), axis.loop)
    (run,) = refusals((factor,), seeds=(1,), noises=(noise,)).runs
    assert (run.value is not None) is given
    stiffness = estimate["stiffness"]
    assert (stiffness.value is not None) is given
    if given:
        assert stiffness.value == pytest.approx(run.value, rel=1e-3)
    else:  # the search may have ended on another band, whose bound is another one
        bounds = {bound.share: bound.stiffness for bound in estimate.checks.bounds}
        assert 1e7 <= (bounds[0.33] or 0.0) < run.stiffness


@pytest.mark.statistical
def test_the_docs_show_these_numbers(found: Refusals) -> None:
    page = (Path(__file__).resolve().parents[2] / "docs" / "methods.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| (\d[\de.+]*) \| [\d.]+ \| [\d.e+]+ \| (\d+) \| (\S+) \| (\d+) \|", page, re.MULTILINE)
    assert [float(row[0]) for row in rows] == [pytest.approx(8e5 * factor) for factor in FACTORS]
    for factor, (_, given, _, true) in zip(FACTORS, rows, strict=True):
        runs = [run for run in found.runs if run.factor == factor]
        assert abs(float(given) - 100 * np.mean([run.value is not None for run in runs])) <= 15, factor  # of 8 runs
        assert abs(float(true) - 100 * np.mean([run.holds for run in runs])) <= 15, factor
