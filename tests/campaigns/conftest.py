"""A small fleet, noise-free: two rigid joints, two days each."""

from __future__ import annotations

from pathlib import Path

import pytest

import jointid as ji

JOINT = """\
[joint]
kind = "prismatic"
[record]
file = "run.npy"
[record.channels]
torque = { column = "torque", unit = "N", timing = "held" }
reference = { column = "reference", unit = "m" }
[controller]
law = "cascade"
position_gain = 100.0
velocity_gain = 2000.0
"""
TRUTH = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}


@pytest.fixture
def place(tmp_path: Path) -> Path:
    """Two rigid joints, two days each, and their joint file."""
    loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
    record = ji.simulated_record(loop, reference, TRUTH, sample_time=1e-3)
    for name in ("a/2026-11-01", "a/20261102", "b/2026-11-01", "b/2026-11-02"):
        path = tmp_path / "logs" / f"{name}.npy"
        path.parent.mkdir(parents=True, exist_ok=True)
        ji.write(record, path)
    ji.write(record, tmp_path / "run.npy")
    (tmp_path / "joint.toml").write_text(JOINT)
    return tmp_path


FLEET = '[fleet]\njoint = "joint.toml"\nrecords = "logs/{joint}/{day}.npy"\n'
