"""A joint by inertia, share, mode and damping ratio, and how soft it may be where its cost is given."""

import math
from collections.abc import Mapping

import numpy as np
import pytest

from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.result.springs import (
    Fit,
    ModeProfile,
    bound_all,
    bound_stiffness,
    describe,
    profile_modes,
    spring,
)
from jointid.estimation.result.verdict import StiffnessBound
from jointid.models.joints import FlexibleJoint
from jointid.records.signals.filtering import Filtering
from studies.stiffness_bounds import random_plant

DIP = 200.0
"""At 30 Hz, where the compliance costs 123."""

DESCRIBED = {"inertia": 3.0, "ratio": 0.04, "share": 0.3, "mode": 25.0}


def test_a_described_joint_has_the_mode_the_share_and_the_damping_it_is_described_by() -> None:
    values = spring(DESCRIBED)
    assert FlexibleJoint.frequencies(values)["free_free"] == pytest.approx(25.0)
    assert values["load_inertia"] == pytest.approx(0.9)
    assert values["motor_inertia"] == pytest.approx(2.1)
    reduced = 0.9 * 2.1 / 3.0
    assert values["damping"] == pytest.approx(2 * 0.04 * np.sqrt(values["stiffness"] * reduced))


def test_a_problem_s_derivatives_are_those_of_its_residual() -> None:
    plant = random_plant(3)
    problem = torque_problem(plant.record, plant.loop, Filtering(), plant.loop.joint.parameters)
    names = ("motor_viscous", "load_viscous", "offset")
    joint = ("motor_inertia", "load_inertia", "stiffness", "damping")
    problem = problem.keeping({p.name: p.start or 0.0 for p in problem.free if p.name not in (*names, *joint)})
    at = describe(problem, (1.0, 400.0), {})
    known = {"inertia": 1.1 * (plant.truth["motor_inertia"] + plant.truth["load_inertia"]), "ratio": 0.05}
    known |= {"share": 0.3, "mode": 50.0} | {name: plant.truth[name] for name in names}
    x = np.array([known[p.name] for p in at.free])
    values = problem.values(at.turn(x))
    assert {name: values[name] for name in spring(known)} == pytest.approx(spring(known))
    _, J = at.linearise(x)
    for i, p in enumerate(at.free):
        step = np.zeros(x.size)
        step[i] = 1e-6 * abs(x[i])
        difference = (at.linearise(x + step)[0] - at.linearise(x - step)[0]) / (2 * step[i])
        assert np.linalg.norm(difference - J[:, i]) <= 1e-3 * np.linalg.norm(J[:, i]), p.name


class Told(ModeProfile):
    """A profile whose cost is known: of a compliance of 1 / mode^2, and of a dip at some mode."""

    __slots__ = ()

    def cost(self, mode: float) -> float:
        return 100.0 + (1e4 / mode**2) ** 2 - DIP * (abs(mode - 30.0) < 1e-6)

    def fit(self, start: Mapping[str, float], evaluations: int, **held: float) -> Fit:
        at = {**start, **held}
        del evaluations
        return Fit(at, self.cost(at["mode"]), self.cost(at["mode"]))


def told(threshold: float, *, dip: bool = False) -> Told:
    made = Told(None, (10.0, 300.0), threshold=threshold)  # type: ignore[arg-type]  # its cost needs no problem
    start = {"inertia": 2.0, "ratio": 0.03, "share": 0.3}
    made.stiff = made.fit(start, 1, mode=300.0)
    made.points = [made.fit(start, 1, mode=float(mode)) for mode in np.geomspace(300.0, 10.0, 10)[1:]]
    made.minima = [made.fit(start, 1, mode=30.0)] if dip else []
    return made


@pytest.mark.parametrize("threshold", [4.0, 25.0])
def test_a_bound_is_where_the_cost_passes_the_threshold(threshold: float) -> None:
    """From below, and as near as three halvings of a step between modes are."""
    limit = 100.0 / threshold**0.25
    bound = bound_stiffness(told(threshold), 0.2, 0.0)
    assert bound.frequency is not None and bound.stiffness is not None
    assert limit / 1.05 < bound.frequency <= limit
    assert bound.stiffness == pytest.approx(0.2 * 0.8 * 2.0 * (2 * np.pi * bound.frequency) ** 2)


def test_a_dip_between_two_modes_makes_the_bound_softer() -> None:
    """The modes on both sides of it are excluded."""
    bound = bound_stiffness(told(4.0, dip=True), 0.2, 0.0)
    assert 20.0 < bound.frequency <= 30.0


def test_a_mode_that_a_smaller_share_excludes_is_excluded() -> None:
    bound = bound_stiffness(told(4.0), 0.2, 150.0)
    assert 100.0 < bound.frequency <= 150.0
    assert [one.share for one in bound_all(told(4.0), (0.2, 0.1))] == [0.1, 0.2]


def test_a_rigid_joint_that_explains_nothing_excludes_nothing() -> None:
    """Its loop is unstable: the threshold was no number, and every mode that was tried excluded."""
    plant = random_plant(3)
    problem = torque_problem(plant.record, plant.loop, Filtering(), plant.loop.joint.parameters)
    rigid = {"inertia": 1e-5, "viscous": 0.1, "coulomb": 0.1, "offset": 0.0}
    made = profile_modes(problem, rigid, plant.truth)
    assert made.room[0] < 0.05 * plant.mode and made.threshold == math.inf
    assert bound_stiffness(made, 0.2, 0.0) == StiffnessBound(0.2, None, None)
