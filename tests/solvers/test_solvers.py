"""One table of problems through every solver that applies: certified regressions, bounds, cliffs, and every status."""

import itertools
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from jointid.common.arrays import orthonormal_basis
from jointid.common.parameters import Parameter, Quantity
from jointid.solvers.solve import Counted, LevenbergMarquardt, Solution, Status, solve
from tests.solvers.nist import REGRESSIONS, Array, Certified

TIGHT = 1e-13
SOLVER = LevenbergMarquardt(TIGHT, 2000)
DIGITS = 6.0  # of the worst parameter; the hardest, MGH09, gives 6.4


@pytest.mark.parametrize("which", [0, 1], ids=["far", "near"])
@pytest.mark.parametrize("regression", REGRESSIONS, ids=lambda r: r.name)
def test_least_squares_gives_the_certified_digits(regression: Certified, which: int) -> None:
    end = solve(regression, SOLVER, np.array(regression.starts[which]))
    assert regression.digits(end.x) > DIGITS
    assert end.status.converged
    assert end.residual @ end.residual == pytest.approx(regression.square, rel=1e-9)
    assert end.jacobian == pytest.approx(regression.linearise(end.x)[1], rel=1e-9)


@pytest.mark.parametrize("regression", [r for r in REGRESSIONS if r.name in ("Misra1a", "Lanczos3", "MGH09")])
def test_the_order_of_the_rows_decides_nothing(regression: Certified) -> None:
    """Sums in another order round differently, as another processor's do; a search ends all the same."""
    rng = np.random.default_rng(9)
    for _ in range(4):
        order = rng.permutation(regression.y.size)
        permuted = replace(regression, x=regression.x[order], y=regression.y[order])
        end = solve(permuted, SOLVER, np.array(regression.starts[1]))
        assert end.status.converged and regression.digits(end.x) > DIGITS


@dataclass(frozen=True)
class Rosenbrock:
    """Rosenbrock's valley as residuals, with bounds; and columns of sizes 1e12 apart."""

    upper: float = np.inf

    @property
    def free(self) -> tuple[Parameter, ...]:
        return Parameter("x", "x", Quantity.FORCE, upper=self.upper), Parameter("y", "y", Quantity.FORCE)

    def linearise(self, x: Array) -> tuple[Array, Array]:
        assert x[0] < self.upper + 1e-12
        a, b = x[0], x[1] * 1e12
        return np.array([10 * (b - a * a), 1 - a]), np.array([[-20 * a, 1e13], [-1.0, 0.0]])


START = np.array([-1.2, 1e-12])


def test_a_step_that_promises_nothing_is_not_made() -> None:
    """Near its end a search that asks what a step is worth evaluates a point less, and ends at the same place."""
    regression, made = REGRESSIONS[0], {}
    for worth in (0.0, 1e-5):
        counted = Counted(regression)
        end = solve(counted, LevenbergMarquardt(1e-4, worth=worth), np.array(regression.starts[1]))
        assert end.status.converged
        made[worth] = counted.evaluations
        np.testing.assert_allclose(end.x, regression.values, rtol=1e-2)
    assert made[1e-5] < made[0.0]


def test_a_curved_valley_is_followed_to_its_end() -> None:
    end = solve(Rosenbrock(), SOLVER, START)
    assert end.status.converged and end.evaluations < 120
    assert end.x == pytest.approx([1.0, 1e-12], rel=1e-6)
    assert all(after <= before for before, after in itertools.pairwise(end.trace))


def test_a_bound_that_holds_is_reached() -> None:
    for start in (START, np.array([3.0, 1e-12])):
        end = solve(Rosenbrock(upper=0.5), SOLVER, start)
        assert end.x == pytest.approx([0.5, 0.25e-12], rel=1e-6)
        assert end.status.converged and end.x[0] == 0.5


class Sum(Rosenbrock):
    """Only the sum of both parameters is seen."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        sizes = np.array([1.0, 2.0, 3.0])
        return sizes * (4.0 - x[0] - x[1]), np.outer(-sizes, [1.0, 1.0])


def test_parameters_that_cannot_be_told_apart_do_no_harm() -> None:
    end = solve(Sum(), SOLVER, np.array([1.0, 0.5]))
    assert end.status.converged and np.abs(end.x).max() < 10.0
    assert end.x.sum() == pytest.approx(4.0)


class Cliff(Rosenbrock):
    """It cannot be evaluated, and is large, before its lowest point."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        if x[0] > 0.0:
            return np.full(2, 1e6), np.zeros((2, 2))
        return super().linearise(x)


@dataclass(frozen=True)
class Runaway(Cliff):
    """Beyond its lowest point its derivatives, or its errors, cannot be squared, or are no numbers."""

    size: float = 1e200

    def linearise(self, x: Array) -> tuple[Array, Array]:
        error, J = Rosenbrock.linearise(self, x)
        return (error, np.full_like(J, self.size)) if x[0] > 0.0 else (error, J)


@pytest.mark.parametrize("size", [1e200, 1e300, np.inf, np.nan])
def test_a_loop_that_runs_away_ends_a_search_and_no_program(size: float) -> None:
    assert solve(Runaway(size=size), LevenbergMarquardt(1e-10), np.array([2.0, 1e-12])).status is Status.NOT_EVALUABLE
    assert solve(Runaway(size=size), LevenbergMarquardt(1e-10), START).x[0] <= 0.0


PROVOKED: dict[Status, Callable[[], Solution]] = {
    Status.STEP: lambda: solve(REGRESSIONS[0], LevenbergMarquardt(1e-3), np.array(REGRESSIONS[0].starts[0])),
    Status.COST: lambda: solve(Rosenbrock(upper=0.5), LevenbergMarquardt(1e-8), START),
    Status.ENOUGH: lambda: solve(Rosenbrock(), LevenbergMarquardt(1e-8, 500, enough=1e-3), START),
    Status.EVALUATION_LIMIT: lambda: solve(Rosenbrock(), LevenbergMarquardt(1e-8, poor=1e-3), START),
    Status.NO_DESCENT: lambda: solve(Cliff(), LevenbergMarquardt(1e-10, 500), START),
    Status.NOT_EVALUABLE: lambda: solve(Cliff(), LevenbergMarquardt(1e-8), np.array([2.0, 1e-12])),
}


@pytest.mark.parametrize("status", PROVOKED)
def test_a_status_is_met(status: Status) -> None:
    assert PROVOKED[status]().status is status


class Slider(Rosenbrock):
    """A stiffness of 300 that slips at a torque of 1: at a torque of nearly 0 nothing tells the stiffness."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        u = np.linspace(-0.02, 0.02, 40)
        z, wound = x[0] * u / x[1], 300.0 * u / np.hypot(1.0, 300.0 * u)
        J = np.column_stack([u / np.hypot(1.0, z) ** 3, (z / np.hypot(1.0, z)) ** 3])
        return x[1] * z / np.hypot(1.0, z) - wound, J


class Fading(Rosenbrock):
    """Far from its least the second parameter is told 1e9 times as well as there."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        J = np.array([[1e9 * (x[1] - 1.0), 1e9 * x[0]], [1e10, 0.0], [0.0, 1.0]])
        return np.array([1e9 * x[0] * (x[1] - 1.0), 1e10 * x[0], x[1] - 2.0]), J


VANISHING = [(Slider(), (3000.0, torque), (300.0, 1.0)) for torque in (0.01, 0.03, 0.1)]


@pytest.mark.parametrize(("problem", "start", "least"), [*VANISHING, (Fading(), (1.0, 5.0), (0.0, 2.0))])
def test_a_column_that_fades_leads_nowhere_and_comes_again(problem: Rosenbrock, start: Array, least: Array) -> None:
    assert solve(problem, SOLVER, np.array(start)).x == pytest.approx(np.array(least), rel=1e-6, abs=1e-6)


class Kinked(Rosenbrock):
    """A residual that grows beyond a curve, on which the least lies, as where friction begins to slip."""

    def linearise(self, x: Array) -> tuple[Array, Array]:
        beyond = x[0] - 1.0 + 0.3 * x[1] ** 2
        steep = 5.0 * (beyond > 0.0)
        error = np.array([x[0] - 3, x[1] - 2, 2 + steep * beyond])
        return error, np.array([[1, 0], [0, 1], [steep, 0.6 * steep * x[1]]])


def test_the_least_at_a_kink_is_found() -> None:
    """Along x = 1 - 0.3 y^2 the criterion is least where 2.2 y + 0.18 y^3 = 2."""
    end = solve(Kinked(), LevenbergMarquardt(1e-8), np.zeros(2))
    assert end.status is Status.KINK
    x, y = end.x
    assert x == pytest.approx(1.0 - 0.3 * y**2, abs=1e-6)
    assert 2.2 * y + 0.18 * y**3 == pytest.approx(2.0, abs=1e-3)
    short = LevenbergMarquardt(1e-6, 60, np.array([10.0, 3e-3]))  # a step along it that the reach has cut is no end
    assert solve(Kinked(), short, np.array([1.0, 0.0])).status is not Status.KINK


def test_evaluations_are_those_counted_and_steps_are_told() -> None:
    told, counted = list[float](), Counted(Rosenbrock())
    first = solve(counted, LevenbergMarquardt(1e-8, 4), START, told.append)
    second = solve(counted, LevenbergMarquardt(1e-8), first.x)
    assert tuple(told) == first.trace[1:]
    assert counted.evaluations == first.evaluations + second.evaluations > 4 == first.evaluations


def test_a_basis_spans_what_nearly_collinear_columns_do() -> None:
    """A column that is off another by 1e-6 counts, one off by 1e-13 does not."""
    rng = np.random.default_rng(1)
    columns = rng.standard_normal((3000, 6))
    columns[:, 1] = columns[:, 0] + 1e-6 * columns[:, 1]
    columns[:, 2] = columns[:, 0] + 1e-13 * columns[:, 2]
    basis = orthonormal_basis(columns, 1e-10)
    assert basis.shape == (3000, 5)
    assert np.max(np.abs(basis.T @ basis - np.eye(5))) < 1e-13
    whole = np.linalg.svd(columns[:, [0, 1, 3, 4, 5]], full_matrices=False)[0]
    assert np.max(np.abs(basis @ (basis.T @ whole) - whole)) < 1e-8
    assert orthonormal_basis(columns[:, :0], 1e-10).shape == (3000, 0)


class Well:
    """A residual of one parameter that is 0 at 0, and falls again beyond 1: where a whole step from near 1 leads."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        return (Parameter("x", "x", Quantity.FORCE),)

    def linearise(self, x: Array) -> tuple[Array, Array]:
        return x / (1 + x**2), ((1 - x**2) / (1 + x**2) ** 2)[:, np.newaxis]


def test_a_step_of_limited_reach_does_not_leap_to_where_nothing_is_told() -> None:
    start = np.array([0.9])
    assert abs(solve(Well(), LevenbergMarquardt(1e-10), start).x[0]) > 5
    for held in ({"reach": np.array([1.0])}, {"admits": lambda x: abs(x[0]) < 1.0}):
        end = solve(Well(), LevenbergMarquardt(1e-10, **held), start)
        assert end.status.converged and end.x[0] == pytest.approx(0.0, abs=1e-6)


def test_a_step_that_its_reach_has_cut_is_no_end() -> None:
    """However short: a hundredth of the way is left to each step, and less than the tolerance."""
    end = solve(REGRESSIONS[0], LevenbergMarquardt(1e-2, 300, np.array([1.0, 1e-5])), np.array([250.0, 5e-4]))
    near = solve(REGRESSIONS[0], LevenbergMarquardt(1e-8), np.array([250.0, 5e-4]))
    assert end.x == pytest.approx(near.x, rel=1e-2)
