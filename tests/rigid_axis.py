"""One rigid axis under a P-P law, its joint file and its records, and the program that is run on them."""

from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.apps.cli import main
from jointid.apps.cli.app import app

TRUTH = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
LOOP = ji.ClosedLoop(ji.RigidJoint("prismatic"), ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
REFERENCE = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
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


def recorded(noise: float = 0.0, seed: int = 0, **others: float) -> ji.Record:
    """Return a record with noise on its torque, N, of an axis some of whose parameters may be others."""
    white = noise * np.random.default_rng(seed).standard_normal(REFERENCE.size)
    return ji.simulated_record(LOOP, REFERENCE, TRUTH | others, sample_time=1e-3, torque_noise=white)


def write_axis(folder: Path, joint: str = JOINT, noise: float = 0.5) -> Path:
    """Write a record and a joint file, and return the path of the joint file."""
    ji.write(recorded(noise), folder / "run.npy")
    (folder / "joint.toml").write_text(joint, encoding="utf-8")
    return folder / "joint.toml"


def run(*words: object) -> int:
    """Run the program and return its exit code."""
    with pytest.raises(SystemExit) as end:
        main([str(word) for word in words])
    assert isinstance(end.value.code, int)
    return end.value.code


def call(*words: object) -> object:
    """Run the program, whose errors are raised, and return what the command returns."""
    return app([str(word) for word in words], result_action="return_value")
