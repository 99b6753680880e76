"""Laws in no pieces: against a slow reference in rate form, the exact drive, and differences."""

from __future__ import annotations

import numpy as np
import pytest


from jointid.common.arrays import FloatArray
from tests.simulation.kernel_case import run
from tests.simulation.oracle import Plant, random_case
from tests.simulation.smooth_oracle import Smooth, simulate, windup

EVENTFUL = 9
SEEDS = (2, EVENTFUL, 12)  # two masses: without a delay, with one of 0.9 and of 2.5 periods
_PERIODS = 60


def _law(name: str, plant: Plant, own: FloatArray, duration: float) -> Smooth:
    e, travel = windup(own), float(np.ptp(own[:, 0]))
    torque = plant.stiffness * e
    return {
        "cubic": Smooth(cubic=0.8 * plant.stiffness / e**2),
        "hysteretic": Smooth(slider=0.4 * plant.stiffness, slips=0.1 * torque),
        "presliding": Smooth(presliding=(0.01 * travel, 0.03 * travel)),
        "load-dependent": Smooth(per_torque=0.2),
        "drifting": Smooth(drift=(-0.5 * min(plant.fv1) / duration, 0.8 * min(plant.fv2) / duration)),
    }[name]


@pytest.mark.parametrize("name", ["cubic", "hysteretic", "presliding", "load-dependent", "drifting"])
@pytest.mark.parametrize("seed", SEEDS)
def test_agrees_with_a_reference_that_locates_every_event(seed: int, name: str) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    _, _, own, _ = run(plant, law, w[:150], post[:150], T, delay, before, x0)
    more = _law(name, plant, own, _PERIODS * T)
    w, post = w[:_PERIODS], post[:_PERIODS]
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0, beyond=more.row)
    expected_u, expected_x = simulate(plant, more, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 5 or seed != EVENTFUL
    np.testing.assert_allclose(u, expected_u, rtol=0, atol=1e-7 * np.abs(expected_u).max())
    np.testing.assert_allclose(x, expected_x, rtol=0, atol=1e-7 * np.abs(expected_x).max())
