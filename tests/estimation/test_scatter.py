"""Whether records agree: the test's size where they do, and the variance between runs where they do not."""

import numpy as np
import pytest

from jointid.estimation.result.agreement import Agreement, Alone, compare_records
from jointid.uncertainty.covariance import covariance_of

NAMES = ("inertia", "viscous", "coulomb")
UNITS = {"inertia": "kg", "viscous": "N s/m", "coulomb": "N"}
COVARIANCE = np.array([[1.0, 0.9, 0.0], [0.9, 1.0, 0.3], [0.0, 0.3, 1.0]]) * np.outer([0.2, 3.0, 0.5], [0.2, 3.0, 0.5])


def run_of(values: np.ndarray, covariance: np.ndarray = COVARIANCE) -> Alone:
    return Alone(dict(zip(NAMES, map(float, values), strict=True)), covariance_of(covariance))


def drawn(random: np.random.Generator, records: int, between: float = 0.0) -> Agreement:
    truth = np.array([95.0, 200.0, 20.0])
    found = []
    for _ in range(records):
        moved = truth + np.array([between * random.standard_normal(), 0.0, 0.0])
        found.append(run_of(random.multivariate_normal(moved, COVARIANCE)))
    return compare_records(found, UNITS)


@pytest.mark.slow
@pytest.mark.parametrize("records", [2, 5])
def test_records_that_agree_are_called_otherwise_as_often_as_said(records: int) -> None:
    random = np.random.default_rng(4)
    found = [drawn(random, records) for _ in range(2000)]
    assert np.mean([one.p_value <= 0.05 for one in found if one.p_value is not None]) == pytest.approx(0.05, abs=0.015)
    assert np.mean([one.parameters[1].p_value <= 0.05 for one in found]) == pytest.approx(0.05, abs=0.015)
    assert np.mean([one.differs for one in found]) <= 0.1


@pytest.mark.slow
def test_the_variance_between_runs_is_found() -> None:
    random = np.random.default_rng(5)
    found = [drawn(random, 8, between=1.0) for _ in range(300)]
    assert np.mean([one.parameters[0].between ** 2 for one in found]) == pytest.approx(1.0, rel=0.15)
    assert all(one.parameters[0].differs for one in found)
    assert found[0].parameters[0].widening == pytest.approx(found[0].parameters[0].between ** 2 / 8)


@pytest.mark.slow
def test_a_widened_interval_holds_the_mean_of_the_runs_truths() -> None:
    """Of five runs that differ by ten times their own deviations; without the widening one in five would hold it."""
    random, inside, narrow = np.random.default_rng(6), 0, 0
    for _ in range(500):
        means = 95.0 + 2.0 * random.standard_normal(5)
        found = [run_of(np.array([m + 0.2 * random.standard_normal(), 200.0, 20.0])) for m in means]
        common, alone = np.mean([one.values["inertia"] for one in found]), 0.2**2 / 5
        wide = alone + compare_records(found, UNITS).parameters[0].widening
        inside += abs(common - 95.0) <= 2 * np.sqrt(wide)
        narrow += abs(common - 95.0) <= 2 * np.sqrt(alone)
    assert 0.85 <= inside / 500 <= 0.97  # five runs tell their own variance to a third
    assert narrow / 500 <= 0.25


def test_two_runs_that_differ_say_so_and_what_two_are_worth() -> None:
    found = compare_records([run_of(np.array([95.0, 200.0, 20.0])), run_of(np.array([97.0, 200.0, 20.0]))], UNITS)
    inertia = found.parameters[0]
    assert inertia.between == pytest.approx(np.sqrt(2.0**2 / 2 - 0.2**2))
    assert inertia.widening == pytest.approx(inertia.between**2 / 2)
    assert found.parameters[2].widening == 0.0


def test_a_difference_along_what_both_know_well_is_seen_jointly() -> None:
    """Each parameter by itself agrees; their well-known difference does not."""
    apart = np.array([0.2, -3.0, 0.0])  # against a correlation of +0.9
    found = compare_records([run_of(np.array([95, 200.0, 20])), run_of(np.array([95, 200.0, 20]) + apart)], UNITS)
    assert found.differs
    assert not any(p.differs for p in found.parameters)


def test_parameters_of_some_records_are_compared_among_those() -> None:
    first = Alone({"inertia": 95.0}, covariance_of(np.array([[0.04]])))
    others = [run_of(np.array([95.0, 200.0, 20.0]))] * 2
    found = compare_records([first, *others], UNITS)
    assert [p.name for p in found.parameters] == [*NAMES]
    assert not found.differs
    nothing = compare_records([first, Alone({"viscous": 3.0}, covariance_of(np.eye(1)))], UNITS)
    assert nothing.p_value is None
    assert not nothing.differs
