"""The least torque error of a rigid joint: one answer from every start, and no motion that was not there."""

from __future__ import annotations

from typing import Literal

import numpy as np
import pytest

import jointid as ji
from jointid.models.controllers import Cascade
from jointid.simulation.synthesis import simulated_record
from tests.servos import Servo, servo

STARTS: tuple[Literal["inversion", "regular"], ...] = ("inversion", "regular")


def identified(case: Servo, start: Literal["inversion", "regular", "given"]) -> ji.Estimate:
    settings = ji.DIDIM("least-squares", start)
    return ji.identify(case.record, case.loop, settings, checks=False)


# From the one start the fixed point begins to move, from the other not.
@pytest.mark.slow
@pytest.mark.parametrize("seed", [8, 14])
def test_an_axis_that_stands_begins_at_rest_from_every_start(seed: int) -> None:
    case = servo(seed)
    found = [identified(case, start) for start in STARTS]
    for estimate in found:
        assert not estimate["initial_velocity"].free
        assert estimate.fit.filtered_error == pytest.approx(found[0].fit.filtered_error, rel=1e-4)
        assert estimate["inertia"].value == pytest.approx(case.truth["inertia"], rel=0.01)
    assert max(estimate.fit.simulations for estimate in found) < 120


@pytest.mark.slow
def test_an_axis_that_moves_is_seen_to_move() -> None:
    case = servo(3, moving=True)
    for start in STARTS:
        line = identified(case, start)["initial_velocity"]
        assert line.free
        assert line.value == pytest.approx(case.velocity, rel=0.05)


def test_a_direction_that_is_never_taken_is_refused() -> None:
    """Of an axis that turns one way only the friction of the other way is not seen."""
    period = 1e-3
    speeds = np.interp(np.arange(4000) * period, [0.0, 0.5, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 2.0, 0.5, 3.0, 1.0])
    law = Cascade(position_gain=30.0, velocity_gain=20.0, integral_gain=100.0, period=period)
    loop = ji.ClosedLoop(ji.RigidJoint(kind="revolute", friction=ji.friction.AsymmetricFriction()), law)
    ways = {f"{name}_{way}": v for name, v in (("viscous", 0.2), ("coulomb", 2.0)) for way in ("forwards", "backwards")}
    truth = {"inertia": 0.1, **ways, "offset": 0.0}
    noise = 0.02 * np.random.default_rng(0).standard_normal(speeds.size)
    whole = simulated_record(loop, np.cumsum(speeds) * period, truth, sample_time=period, torque_noise=noise)
    with pytest.raises(ji.MethodError, match="excites viscous_backwards, coulomb_backwards"):
        ji.identify(whole.without("motor_position"), loop, checks=False)
