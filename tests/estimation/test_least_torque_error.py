"""The least torque error of a rigid joint: one answer from every start, and no motion that was not there."""

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import ignore_progress
from jointid.estimation.descent import History, search_rigid_joint
from jointid.estimation.problems.simulated import torque_problem
from jointid.estimation.rigid_starts import inversion_start, regular_start
from jointid.models.controllers import Cascade
from jointid.simulation.synthesis import simulated_record
from tests.servos import servo


@pytest.mark.slow
@pytest.mark.parametrize(("seed", "moving"), [(8, False), (14, False), (3, True)])
def test_a_motion_at_the_first_sample_is_found_from_every_start(seed: int, moving: bool) -> None:
    case = servo(seed, moving)
    problem = torque_problem(case.record, case.loop, ji.Filtering(), case.loop.joint.parameters)
    ends = [
        search_rigid_joint(problem, [make(problem)], History(ignore_progress))
        for make in (inversion_start, regular_start)
    ]
    for end in ends:
        assert end.norm == pytest.approx(ends[0].norm, rel=5e-3)
        assert end.values["initial_velocity"] == pytest.approx(case.velocity if moving else 0.0, rel=0.05)
        assert moving or end.values["inertia"] == pytest.approx(case.truth["inertia"], rel=0.01)


def test_a_direction_that_is_never_taken_is_refused() -> None:
    """Of an axis that turns one way only the friction of the other way is not seen."""
    period = 1e-3
    speeds = np.interp(np.arange(4000) * period, [0.0, 0.5, 1.0, 2.0, 3.0, 4.0], [0.0, 0.0, 2.0, 0.5, 3.0, 1.0])
    law = Cascade(position_gain=30.0, velocity_gain=20.0, integral_gain=100.0, period=period)
    loop = ji.ClosedLoop(ji.RigidJoint(kind="revolute", friction=ji.friction.Friction("asymmetric")), law)
    ways = {f"{name}_{way}": v for name, v in (("viscous", 0.2), ("coulomb", 2.0)) for way in ("forwards", "backwards")}
    truth = {"inertia": 0.1, **ways, "offset": 0.0}
    noise = 0.02 * np.random.default_rng(0).standard_normal(speeds.size)
    whole = simulated_record(loop, np.cumsum(speeds) * period, truth, sample_time=period, torque_noise=noise)
    with pytest.raises(ji.MethodError, match="excites viscous_backwards, coulomb_backwards"):
        ji.identify(whole.without("motor_position"), loop, checks=False)
