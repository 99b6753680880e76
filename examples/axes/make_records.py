"""Records of the typical axes, simulated under their joint files.

python examples/axes/make_records.py belt        writes belt.csv into the current folder; without a name all of them

Each axis follows its `motion`, and noise is added to its torque.
"""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import jointid as ji

HERE = Path(__file__).parent
TRAPEZOIDS = ji.excitation.trapezoids


@dataclass(frozen=True)
class Axis:
    """A typical axis.

    Attributes:
        values: of the joint, on the load's side, in SI units.
        motion: speeds, acceleration and travel of the trapezoids.
        added: amplitude of a multisine on the torque, on the load's side, and its highest frequency, Hz.
        noise: standard deviation of the torque's noise, on the load's side.
    """

    values: dict[str, float]
    motion: tuple[tuple[float, ...], float, float]
    sample_time: float
    noise: float
    added: tuple[float, float] | None = None


def flexible(
    motor: float, load: float, stiffness: float, damping: float, viscous: float, coulomb: float
) -> dict[str, float]:
    """Return the values of a flexible joint whose friction is shared by both sides."""
    return {
        "motor_inertia": motor, "motor_viscous": 0.5 * viscous, "motor_coulomb": 0.5 * coulomb,
        "stiffness": stiffness, "damping": damping,
        "load_inertia": load, "load_viscous": 0.5 * viscous, "load_coulomb": 0.5 * coulomb, "offset": 0.0,
    }  # fmt: skip


AXES = {
    "rotary-table": Axis(
        {"inertia": 0.5, "viscous": 0.8, "coulomb": 2.0, "offset": 0.0}, ((1.0, 3.0, 6.0), 40.0, 3.0), 1e-3, 0.3
    ),
    "ball-screw": Axis(
        flexible(590.0, 200.0, 1e8, 4e3, 2e3, 200.0), ((0.05, 0.1, 0.2), 3.0, 0.1), 5e-4, 20.0, (600.0, 250.0)
    ),
    "rack-and-pinion": Axis(
        flexible(590.0, 500.0, 2e7, 8e3, 800.0, 300.0), ((0.2, 0.4, 0.8), 4.0, 0.4), 1e-3, 20.0, (800.0, 90.0)
    ),
    "belt": Axis(flexible(19.0, 20.0, 1e6, 200.0, 60.0, 50.0), ((0.3, 0.6, 1.2), 8.0, 0.6), 1e-3, 2.0, (60.0, 100.0)),
    "robot-wrist": Axis(
        flexible(0.3, 0.1, 1e4, 2.0, 6.0, 8.0), ((0.5, 1.0, 2.0), 15.0, 1.0), 1e-3, 0.3, (15.0, 110.0)
    ),
    "leg": Axis(
        {"inertia": 0.03, "viscous": 0.05, "coulomb": 0.3, "gravity_cos": 0.0, "gravity_sin": 2.5, "offset": 0.0},
        ((2.0, 5.0, 10.0), 120.0, 1.5), 1e-3, 0.05,
    ),
}  # fmt: skip


def make(name: str, target: Path, duration: float = 12.0) -> ji.Record:
    """Simulate the record of an axis, and write it to a file."""
    axis, file = AXES[name], ji.load(HERE / f"{name}.toml")
    T = axis.sample_time
    reference = TRAPEZOIDS(*axis.motion, T, rest=0.1, duration=duration)
    samples = reference.size
    added = None
    if axis.added is not None:
        size, highest = axis.added
        added = ji.excitation.multisine(samples, T, size, 2.0, highest, lines=60)
    noise = axis.noise * np.random.default_rng(0).standard_normal(samples)
    record = ji.simulated_record(
        file.loop, reference, axis.values, sample_time=T, injected=added, torque_noise=noise, name=name
    )
    file.write(record, target)
    return record


if __name__ == "__main__":
    for name in sys.argv[1:] or AXES:
        make(name, Path(f"{name}.csv"))
        print(f"Written: {name}.csv")  # noqa: T201
