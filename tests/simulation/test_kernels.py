"""Both kernels of joints without a controller: rest to the last bit, dips, and what cannot be simulated."""

import math

import numpy as np
import pytest

from jointid.common.arrays import FloatArray
from jointid.models.friction import FRICTIONS
from jointid.models.joints import FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import Counterbalance, Gravity
from jointid.paper.twin import TABLE_2
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome, integrate, motion_of, pass_on
from tests.simulation.reference import simulate

T = 1e-3
SLIDER = dict(TABLE_2)
JOINT = FlexibleJoint("prismatic")


def free(
    joint: Joint, values: dict[str, float], torque: FloatArray, x0: FloatArray, period: float = T, way: str = "exact"
) -> tuple[Outcome, FloatArray, FloatArray, int]:
    """Return outcome, positions and velocities, (periods, masses), and events of a joint under torques.

    The ways are the maps of lines ("exact"), the steps of any law, and the slow reference.
    """
    plant, loop = Numbers.of_joint(joint, values).plant, pass_on(torque[np.newaxis], period)
    n, none = len(plant.masses), np.zeros((1, 0))
    place, speed, before = x0[: 2 * n : 2].copy(), x0[1 : 2 * n : 2].copy(), torque[:1]
    if way == "reference":
        return Outcome.FINISHED, *simulate(
            plant, None, np.zeros((0, 10)), loop, before, none, place, speed, np.sign(speed)
        )[1:]
    outcome, _, _, tape, path, counts = integrate(
        plant, None, np.zeros((0, 10)), loop, before, np.array([math.inf]), none, place, speed, np.sign(speed),
        keep=True, straight=way == "exact",
    )  # fmt: skip
    if way == "steps":
        return outcome, *motion_of(tape, n, torque.size)[:2], int(counts[0])
    return outcome, path.states[:, : 2 * n : 2], path.states[:, 1 : 2 * n : 2], int(counts[0])


WAYS = pytest.mark.parametrize("way", ["exact", "steps"])


@WAYS
def test_stands_exactly_still_at_rest_and_comes_loose_beyond_the_cone(way: str) -> None:
    force = np.linspace(-13.0, 6.8, 300)  # within the motor's cone, shifted by the offset
    x0 = np.array([0.1234567, 0.0, 0.1234567, 0.0])
    outcome, q, v, events = free(JOINT, SLIDER, force, x0, way=way)
    assert (outcome, events) == (Outcome.FINISHED, 0)
    assert np.all(q == q[0]) and not np.any(v)
    values = {"inertia": 2.0, "viscous": 0.0, "coulomb": 5.0, "offset": 0.5}
    for push, moves in ((5.5, False), (5.5 + 1e-7, True), (-4.5, False), (-4.5 - 1e-7, True)):
        _, q, _, _ = free(RigidJoint("prismatic"), values, np.full(20, push), np.zeros(2), way=way)
        assert bool(np.any(q)) is moves


@WAYS
@pytest.mark.parametrize("eps", [6e-5, 2e-4, 1e-3])
@pytest.mark.parametrize("period", [2e-3, 3e-2])
def test_a_velocity_that_dips_below_nothing_for_a_moment_is_seen(way: str, eps: float, period: float) -> None:
    """A load that swings in a motion, just faster than its mean, turns round twice at each swing."""
    speed, coulomb = 0.1, 1e-3
    values = dict.fromkeys(SLIDER, 0.0) | {"motor_inertia": 1e9, "load_inertia": 1.0, "stiffness": 1e4}
    values["load_coulomb"] = coulomb
    pulled = speed * (1 + eps) * 100.0 + coulomb
    x0, fine = np.array([0.0, speed, -pulled / 1e4, speed]), round(period / 1e-3)
    periods = round(0.08 / period)
    _, _, v, events = free(JOINT, values, np.zeros(periods), x0, period, way)
    _, _, expected, seen = free(JOINT, values, np.zeros(periods * fine), x0, period / fine, "reference")
    assert events == seen == 2
    np.testing.assert_allclose(v, expected[::fine], rtol=0, atol=(1e-8 if way == "exact" else 1e-3) * speed)


def test_a_stop_at_the_end_of_a_period_ends_no_simulation() -> None:
    """What rounding leaves of a period after it is no step that is too short."""
    for speed in (0.1, 0.2, 1.0, 1.0 / 3.0):
        for periods in range(3, 30):
            values = {"inertia": 1.0, "viscous": 0.0, "coulomb": speed / (periods * T), "offset": 0.0}
            outcome, _, v, _ = free(
                RigidJoint("prismatic"), values, np.zeros(periods + 3), np.array([0.0, speed]), way="steps"
            )
            assert outcome is Outcome.FINISHED and abs(v[-1, 0]) < 1e-12


def test_a_mass_under_presliding_friction_creeps_until_its_spring_carries_it() -> None:
    """A constant push below Fc moves it by s ln(1 / (1 - push / Fc)), where the wound-up friction carries the push."""
    values = {"inertia": 1.0, "viscous": 2000.0, "coulomb": 10.0, "presliding_distance": 1e-3, "offset": -6.0}
    joint = RigidJoint("prismatic", FRICTIONS["presliding"])
    _, q, _, _ = free(joint, values, np.zeros(5000), np.zeros(2), way="steps")
    assert q[-1, 0] == pytest.approx(1e-3 * np.log(1 / (1 - 0.6)), rel=1e-4)


def test_a_load_that_friction_holds_stays_where_it_is_to_the_last_bit() -> None:
    joint = FlexibleJoint("revolute", gravity=Gravity("link", Counterbalance(rate=2.0)))
    values = SLIDER | {"motor_coulomb": 80.0, "load_coulomb": 80.0, "stiffness": 5e3, "gravity_cos": 40.0}
    values |= {"gravity_sin": 15.0, "counterbalance_rate": 2.0}
    for position in np.random.default_rng(0).uniform(-1e-3, 1e-3, 20):  # less than the spring gives
        _, q, _, events = free(joint, values, np.zeros(300), np.array([0.0, 0.0, position, 0.0]), way="steps")
        assert events == 0
        assert np.array_equal(q, np.tile([0.0, position], (300, 1)))


def test_a_joint_far_too_stiff_returns_a_status_in_bounded_work() -> None:
    force = 200.0 * np.sin(2 * np.pi * 5.0 * np.arange(500) * T)
    for stiffness in 10.0 ** np.arange(7, 21):
        values = SLIDER | {"stiffness": stiffness, "damping": 0.0}
        outcome, q, _, _ = free(JOINT, values, force, np.array([0.0, 0.1, 0.0, -0.1]))
        assert outcome is not Outcome.FINISHED or np.all(np.isfinite(q))  # else what follows is not written
        assert outcome is Outcome.TOO_STIFF or stiffness < 1e9  # a mode as fast as the log
