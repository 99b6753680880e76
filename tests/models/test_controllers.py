"""Laws turned round, and the units in which they count."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.models.controllers import (
    INPUTS,
    PD,
    POSITION,
    REFERENCE,
    Cascade,
    Controller,
    DigitalFilter,
    StateSpaceController,
    invert,
    run,
    scale,
)

T = 1e-3
RANDOM = np.random.default_rng(0)
REFERENCE_SIGNAL = np.cumsum(RANDOM.normal(0, 1e-3, 300))
POSITION_SIGNAL = REFERENCE_SIGNAL + RANDOM.normal(0, 1e-4, 300)

LAWS: dict[str, Controller] = {
    "cascade": Cascade(position_gain=160.0, velocity_gain=240.0, velocity_filter=(0.5, 0.5), gain=35.0),
    "cascade, unfiltered": Cascade(position_gain=160.0, velocity_gain=240.0),
    "PD": PD(position_gain=4e5, derivative_gain=6e3, velocity_filter=DigitalFilter((0.3,), (1.0, -0.7))),
    "PD, damping only": PD(
        position_gain=4e5, derivative_gain=6e3, reference_velocity="none", velocity_filter=(0.25, 0.5, 0.25)
    ),
    "integrating": StateSpaceController(
        A=[[1.0]], B={"reference": [0.1], "position": [-0.1]}, C=[50.0], D={"reference": 4e3, "position": -4e3}
    ),
    "proportional": StateSpaceController(A=[], B={}, C=[], D={"reference": 1e4, "position": -1e4}),
}


def inputs(reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    made = np.zeros((reference.size, INPUTS))
    made[:, REFERENCE], made[:, POSITION] = reference, position
    return made


def at_rest(controller: Controller, reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    law = controller.law(T)
    return law.memory(REFERENCE, reference[0], 0.0) + law.memory(POSITION, position[0], 0.0)


def output(controller: Controller, reference: np.ndarray, position: np.ndarray) -> np.ndarray:
    return run(controller.law(T), inputs(reference, position), at_rest(controller, reference, position)).raw[:, 0]


@pytest.mark.parametrize("name", [name for name in LAWS if name != "integrating"])
def test_a_law_turned_round_gives_the_position_back(name: str) -> None:
    controller, r, q = LAWS[name], REFERENCE_SIGNAL, POSITION_SIGNAL
    torque = output(controller, r, q)
    found = invert(controller.law(T), torque, inputs(r, np.zeros_like(r)), at_rest(controller, r, q))
    assert np.max(np.abs(found - q)) <= 1e-9 * np.ptp(q)


def test_the_excess_is_fed_back_in_controller_units() -> None:
    law = StateSpaceController(A=[[1.0]], B={"excess": [0.5]}, C=[2.0], D={"reference": 1.0}, gain=10.0, limit=3.0)
    lowered = law.law(T)
    assert lowered.limit == 30.0
    assert lowered.F[0, 0, 0] * 10.0 == 0.5
    assert scale(lowered, 4.0).F[0, 0, 0] * 40.0 == 0.5


def test_the_period_is_the_log_s_unless_the_law_has_its_own() -> None:
    assert Cascade(position_gain=1.0, velocity_gain=1.0).law(2e-3).period == 2e-3
    assert Cascade(position_gain=1.0, velocity_gain=1.0, period=5e-4).law(2e-3).period == 5e-4
