"""A law seen through a transmission is the same law, in other units of position and torque."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import (
    INJECTED,
    PD,
    PID,
    POSITION,
    REFERENCE,
    REFERENCE_VELOCITY,
    Cascade,
    Controller,
    FirstOrder,
    invert,
    run,
)
from jointid.models.controllers.laws import StateSpaceController
from jointid.models.controllers.sampled import scale
from tests.geared import RATE

T, RATIOS = RATE, (100.0, -100.0, 2 * np.pi / 0.01, -0.3)
FED = {"acceleration_feedforward": 2e-4, "viscous_feedforward": 1e-3, "coulomb_feedforward": 0.03}
LAWS = {
    "PI cascade that holds": Cascade(
        position_gain=25.0,
        velocity_gain=0.02,
        integral_gain=30.0,
        limit=0.6,
        velocity_limit=35.0,
        gain=1.5,
        constant_feedforward=0.02,
        **FED,
    ),
    "slow cascade that tracks": Cascade(
        position_gain=25.0,
        velocity_gain=0.02,
        integral_gain=30.0,
        limit=0.6,
        anti_windup="track",
        position_period=4 * T,
        velocity_feedforward=0.9,
        torque_filters=(FirstOrder(time_constant=2e-3),),
    ),
    "PID": PID(position_gain=0.5, integral_gain=4.0, derivative_gain=0.02, limit=0.6, velocity_filter=(0.5, 0.5)),
    "PD with a channel": PD(position_gain=0.5, derivative_gain=0.02, reference_velocity="channel", limit=0.6),
    "state space": StateSpaceController(
        A=[[0.5]],
        B={"reference": [0.1], "position": [-0.1], "excess": [0.05]},
        C=[1.0],
        D={"reference": 0.4, "position": -0.4},
        limit=0.6,
        gain=2.0,
    ),
}


@pytest.mark.parametrize("ratio", RATIOS)
@pytest.mark.parametrize("controller", LAWS.values(), ids=LAWS)
def test_a_law_gives_ratio_times_what_it_gives_to_ratio_times_the_motion(controller: Controller, ratio: float) -> None:
    own, seen = controller.law(T), replace(controller, ratio=ratio).law(T)  # type: ignore[type-var]
    rng = np.random.default_rng(1)
    inputs = np.cumsum(rng.standard_normal((400, 6)), axis=0)
    inputs[:, 2] = np.sign(rng.standard_normal(400))
    inputs[:, 3] = 1.0
    moved = inputs.copy()
    moved[:, [REFERENCE, REFERENCE_VELOCITY, POSITION]] /= ratio
    moved[:, 2] *= np.sign(ratio)
    moved[:, INJECTED] *= ratio
    plain, turned = (run(law, signals, np.zeros(law.order)) for law, signals in ((own, inputs), (seen, moved)))
    assert np.max(np.abs(plain)) == pytest.approx(own.limit)  # or limits and gates would not be tried
    np.testing.assert_allclose(turned, ratio * plain, rtol=1e-9, atol=1e-12 * abs(ratio))
    assert seen.limit == pytest.approx(abs(ratio) * own.limit)


def test_the_excess_is_fed_back_in_controller_units() -> None:
    law = StateSpaceController(A=[[1.0]], B={"excess": [0.5]}, C=[2.0], D={"reference": 1.0}, gain=10.0, limit=3.0)
    lowered = law.law(T)
    assert lowered.limit == 30.0
    assert lowered.F[0, 0, 0] * 10.0 == 0.5
    assert scale(lowered, 4.0).F[0, 0, 0] * 40.0 == 0.5


@pytest.mark.parametrize("controller", [LAWS["PD with a channel"], replace(LAWS["PID"], integral_gain=0.0)])
def test_a_law_turned_round_gives_the_position_back(controller: Controller) -> None:
    law, inputs = replace(controller, limit=np.inf).law(T), np.zeros((300, 6))  # type: ignore[type-var]
    rng = np.random.default_rng(0)
    inputs[:, REFERENCE] = np.cumsum(rng.normal(0, 1e-3, 300))
    inputs[:, POSITION] = inputs[:, REFERENCE] + rng.normal(0, 1e-4, 300)
    start = law.memory(REFERENCE, inputs[0, REFERENCE], 0.0) + law.memory(POSITION, inputs[0, POSITION], 0.0)
    found = invert(law, run(law, inputs, start), inputs, start)
    assert np.max(np.abs(found - inputs[:, POSITION])) <= 1e-9 * np.ptp(inputs[:, POSITION])
