"""Every friction and spring law: its algebra, and a joint with it through simulation, joint file and JSON."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from jointid.models.controllers import Cascade
from jointid.models.friction import FRICTIONS, PARTS, Friction
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.models.springs import Spring
from jointid.output import json as answers
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from jointid.tuning.proposals import lumped_parameters
from tests.estimates import identify

EVERY_LAW = pytest.mark.parametrize("law", FRICTIONS.values(), ids=list(FRICTIONS))
MORE = {"stribeck_force": 4.0, "stribeck_speed": 0.02, "presliding_distance": 2e-3, "friction_per_torque": 0.1}
MORE |= {"viscous_drift": -1.5, "coulomb_drift": -0.4}
CASCADE = Cascade(position_gain=60.0, velocity_gain=500.0)


def values_of(law: Friction) -> dict[str, float]:
    """Return a number for each parameter of a rigid joint, no two alike."""
    sizes = {"viscous": 20.0, "coulomb": 10.0}
    friction = {c.name: sizes[c.part] * (1.0 + 0.1 * i) for i, c in enumerate(law.coefficients)}
    friction |= {p.name: MORE[p.name] for p in law.parameters() if p.name not in friction}
    offset = 0.0 if law.two_ways else 1.5
    return {"inertia": 5.0, **friction, "offset": offset}


@EVERY_LAW
def test_a_law_has_one_coefficient_for_each_part_and_direction(law: Friction) -> None:
    assert law.linear == (law.lines == law) == (len(law.parameters()) == len(law.coefficients))
    acting = [(c.part, c.way) for c in law.coefficients]
    assert len(set(acting)) == len(acting)


@EVERY_LAW
def test_columns_times_parameters_are_the_force_of_the_directions(law: Friction) -> None:
    velocity = np.random.default_rng(3).standard_normal(50)
    velocity[::7] = 0.0
    values = values_of(law)
    viscous, viscous_back, coulomb, coulomb_back = law.directions(values)
    force = np.where(velocity > 0, viscous * velocity + coulomb, viscous_back * velocity - coulomb_back)
    force[velocity == 0] = 0.0
    x = np.array([values[p.name] for p in law.lines.parameters()])
    np.testing.assert_allclose(law.columns(velocity) @ x, force, rtol=0, atol=1e-13)


@EVERY_LAW
def test_an_offset_is_identifiable_unless_the_law_spans_it(law: Friction) -> None:
    velocity = np.array([-2.0, -1.0, 1.0, 2.0])
    X = law.columns(velocity)
    both = np.column_stack([X, np.ones(4)])
    assert law.two_ways != (np.linalg.matrix_rank(both) > np.linalg.matrix_rank(X))
    if law.two_ways:
        weights = law.constant()
        np.testing.assert_array_equal(X @ [2 * weights.get(p.name, 0.0) for p in law.lines.parameters()], 1.0)


@EVERY_LAW
def test_its_bands_follow_each_other_without_a_step(law: Friction) -> None:
    bands = law.bands(values_of(law))
    assert bands[-1] == (np.inf, law.directions(values_of(law)))
    for (high, one), (higher, other) in pairwise(bands):
        assert high < higher
        for viscous, coulomb in ((0, 2), (1, 3)):
            here, there = (lines[viscous] * high + lines[coulomb] for lines in (one, other))
            assert here == pytest.approx(there, rel=1e-12)


@EVERY_LAW
def test_a_joint_is_simulated_identified_and_read_back_with_its_own_law(law: Friction, tmp_path: Path) -> None:
    joint, truth = RigidJoint("prismatic", friction=law), values_of(law)
    loop = ClosedLoop(joint, CASCADE)
    reference = trapezoids([0.1, 0.3], 20.0 if "friction_per_torque" in truth else 2.0, 0.2, 1e-3, 0.1, 4.0)
    record = simulated_record(loop, reference, truth, sample_time=1e-3)
    found = identify(record, loop)
    assert found.values == pytest.approx(truth, rel=1e-3, abs=1e-9)
    (tmp_path / "out.json").write_text(answers.dumps(answers.to_dict(found)), "utf-8")
    assert answers.load_estimate(tmp_path / "out.json", loop).values == pytest.approx(found.values)
    lumped, directions = lumped_parameters(found), np.array(law.directions(found.values))
    for i, part in enumerate(PARTS):
        assert lumped[part][1] == pytest.approx(directions[2 * i : 2 * i + 2].mean())


def test_the_torque_of_the_pieces() -> None:
    values = {"stiffness": 2.0, "stiffness_2": 4.0, "stiffness_3": 8.0, "torque_1": 2.0, "torque_2": 6.0}
    values["damping"] = 0.0
    spring, still = Spring("three-piece"), np.zeros(6)
    deflection = np.array([0.5, 1.0, 1.5, 2.0, 2.5, -2.5])  # edges at 1 and 2
    np.testing.assert_allclose(spring.torque(values, deflection, still), [1.0, 2.0, 4.0, 6.0, 10.0, -10.0])
    gap = {"stiffness": 2.0, "gap": 1.0, "damping": 3.0}
    torque = Spring("backlash").torque(gap, np.array([0.4, -1.5]), np.ones(2))
    np.testing.assert_allclose(torque, [0.0, -2.0 + 3.0])


def test_the_deflection_is_the_smallest_that_holds_a_torque() -> None:
    rng, grid = np.random.default_rng(0), np.linspace(0.0, 2.0, 2001)
    for spring in map(Spring, 100 * ("three-piece", "cubic", "backlash-cubic", "two-piece-cubic", "three-piece-cubic")):
        values = {p.name: 400.0 * rng.random() for p in spring.parameters} | {"torque_1": 20.0, "torque_2": 50.0}
        values |= {"gap": rng.random(), "cubic_stiffness": rng.uniform(-500.0, 500.0)}
        torques = spring.torque(values, grid, np.zeros_like(grid))
        asked = rng.random() * max(torques)
        found = spring.deflection(values, -asked)
        assert spring.torque(values, np.array([found]), np.zeros(1)) == pytest.approx(-asked)
        assert np.all(torques[grid < -found] <= asked + 1e-9)
