"""Friction that is another at low speed: against a slow reference, the plain joint, and differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.simulation.kernel_case import run
from tests.simulation.oracle import Plant, random_case
from tests.simulation.oracle import simulate as reference

# Rigid; and with two masses: without a delay, with one of 0.9, of 1.5 and of 2.5 periods.
SEEDS = (0, 1, 2, 9, 12)


def slowly_other(plant: Plant, speeds: tuple[float, float], sign: float) -> Plant:
    """A friction that rises, or falls, towards standstill on both sides."""
    changes = [sign * 0.5 * min(fc) for fc in (plant.fc1, plant.fc2)]
    points = [
        ((0.0, change), (0.02 * speed, 0.8 * change), (0.1 * speed, 0.2 * change), (0.3 * speed, 0.0))
        for change, speed in zip(changes, speeds, strict=True)
    ]
    return replace(plant, more1=points[0], more2=() if plant.inertia2 is None else points[1])


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("seed", SEEDS)
def test_agrees_with_a_reference_that_locates_every_event(seed: int, sign: float) -> None:
    plant, law, w, post, T, delay, before, x0 = random_case(seed)
    n = 200
    w, post = w[:n], post[:n]
    _, _, own, _ = run(plant, law, w, post, T, delay, before, x0)
    plant = slowly_other(plant, tuple(np.max(np.abs(own[:, [1, 3]]), axis=0)), sign)
    status, u, x, counts = run(plant, law, w, post, T, delay, before, x0)
    expected = reference(plant, law, w, post, T, delay, before, x0)
    assert status == 0
    assert counts[0] > 4
    print(seed, sign, counts, np.abs(u-expected.u).max()/np.abs(expected.u).max())
    np.testing.assert_allclose(u, expected.u, rtol=0, atol=1e-10 * np.abs(expected.u).max())
    np.testing.assert_allclose(x[:, : expected.x.shape[1]], expected.x, rtol=0, atol=1e-10 * np.abs(expected.x).max())
