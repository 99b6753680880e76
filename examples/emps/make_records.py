"""Two records like those of EMPS, for whoever has not downloaded the real ones: same names, units, loop and motion.

python examples/emps/make_records.py        writes like-emps.mat and like-emps-pulses.mat into the current folder

The axis is simulated with the published mass and friction. So that it is no better known than a real one, its friction
differs with the direction, its screw has a ripple, and a random force acts on it: none of that is in `joint.toml`.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import jointid as ji

TRUTH = {
    "inertia": 95.11,
    "viscous_forwards": 190.0,
    "coulomb_forwards": 18.5,
    "viscous_backwards": 217.0,
    "coulomb_backwards": 22.3,
    "offset": 0.0,
}
SAMPLE_TIME = 1e-3
RIPPLE, PITCH = 2.0, 0.04  # N, m
RANDOM = 1.5  # N, in every sample
ENCODER_STEP = 5e-8  # m


def main() -> None:
    """Simulate both records and write them."""
    file = ji.load(Path(__file__).with_name("joint.toml"))
    loop = replace(file.loop, joint=ji.RigidJoint("prismatic", friction=ji.friction.Friction("asymmetric")))
    reference = ji.excitation.trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, SAMPLE_TIME, duration=24.0)
    added = ji.excitation.pulses(reference.size, SAMPLE_TIME, height=178.0, width=0.02, every=0.4, seed=0)  # N
    ripple = RIPPLE * np.sin(2 * np.pi * reference / PITCH)
    for name, injected, seed in (("like-emps.mat", None, 1), ("like-emps-pulses.mat", added, 2)):
        force = ripple + RANDOM * np.random.default_rng(seed).standard_normal(reference.size)
        record = ji.simulated_record(
            loop, reference, TRUTH,
            sample_time=SAMPLE_TIME, injected=injected, at="before_limit",
            disturbance=force, encoder_step=ENCODER_STEP,
        )  # fmt: skip
        file.write(record, name)
        print(f"Written: {name}")  # noqa: T201


if __name__ == "__main__":
    main()
