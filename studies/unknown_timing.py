"""Intervals of rigid joints where nobody stated whether the logged torque is held or sampled.

A joint under a PD law is simulated by small steps, apart from the package's simulation. The law runs at the log's rate,
whose torque is held, or at each step, whose torque is sampled. IDIM is not told which.
"""

from __future__ import annotations

import numpy as np

from jointid.diagnostics.identify import identify
from jointid.estimation.methods.idim import IDIM
from jointid.models.joints import RigidJoint
from jointid.records.record import Channel, Record, Timing

TRUE = {"inertia": 0.05, "viscous": 0.4, "coulomb": 0.5}
"""The joint: kg m2, N m s/rad and N m."""

_RATES = 30.0, 1000.0  # Hz
_DURATION = 12.0  # s
_STEP = 2e-4  # s, at most; and a tenth of a sample
_NOISE = 0.02  # of the torque


def judge(seed: int, held: bool) -> dict[str, float]:
    """Return the error of each parameter in its deviations, at a rate that is drawn."""
    low, high = np.log(_RATES)
    rate = float(np.exp(np.random.default_rng([seed, 1]).uniform(low, high)))
    found = identify(logged(rate, held, seed), RigidJoint("revolute"), IDIM(), checks=False)
    return {
        name: float(((found[name].value or 0.0) - true) / (found[name].stderr or 0.0)) for name, true in TRUE.items()
    }


def logged(rate: float, held: bool, seed: int, noise: float = _NOISE) -> Record:
    """Return the record of a joint that follows four sines.

    Args:
        rate: of the log, Hz.
        held: whether the law runs at that rate, else at each step.
        seed: of sines and noise.
        noise: on the log, of the torque.
    """
    rng, period = np.random.default_rng(seed), 1 / rate
    parts = max(round(period / _STEP), 10)
    step, size = period / parts, round(_DURATION * rate)
    w = 2 * np.pi * rng.uniform(0.15, 0.022 * min(rate, 60.0), 4)
    a = 0.8 / w * rng.uniform(0.5, 1.5, 4)
    phase = rng.uniform(0, 6, 4)
    time = step * np.arange(size * parts)[:, np.newaxis]
    follow, forwards = (a * np.sin(w * time + phase)).sum(1), (a * w * np.cos(w * time + phase)).sum(1)
    q, v, u = float(follow[0]), float(forwards[0]), 0.0
    stiff, inertia = min(2 * np.pi * rate / 25, 40.0), TRUE["inertia"]
    drop = step * TRUE["coulomb"] / inertia
    kept = np.zeros((size, 2))
    for k, (reference, speed) in enumerate(zip(follow.tolist(), forwards.tolist(), strict=True)):
        if not held or k % parts == 0:
            u = inertia * (stiff**2 * (reference - q) + 1.4 * stiff * (speed - v)) + 0.4 * speed
        if k % parts == 0:
            kept[k // parts] = q, u
        free = v + step * (u - TRUE["viscous"] * v) / inertia
        v = max(free - drop, 0.0) if free > 0 else min(free + drop, 0.0)
        q += step * v
    torque = kept[:, 1] + noise * kept[:, 1].std() * rng.standard_normal(size)
    return Record(
        torque=Channel(torque, "N m", period, Timing.HELD, stated=False),
        motor_position=Channel(kept[:, 0], "rad", period),
    )
