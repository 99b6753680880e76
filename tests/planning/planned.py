"""Tests of a joint for the tests of planning: as records, and predicted at known values."""

from collections.abc import Mapping
from typing import Any

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.planning.joints import RUNS, JointModel
from jointid.planning.predict import Noise, PredictedTest
from jointid.records.record import Injection, Timing

T = 1e-3
LOOP = ji.ClosedLoop(
    ji.RigidJoint("revolute"), ji.controller.Cascade(position_gain=40.0, velocity_gain=2.0, integral_gain=30.0)
)
TRUTH = {"inertia": 0.04, "viscous": 0.05, "coulomb": 0.1, "offset": 0.02}


def planned_record(
    loop: ji.ClosedLoop, reference: FloatArray, sample_time: float, injected: FloatArray | None = None
) -> ji.Record:
    """Return a test as a record without torque."""
    unit, position = loop.joint.force_unit, "m" if loop.joint.kind == "prismatic" else "rad"
    added = None if injected is None else Injection(ji.Channel(injected, unit, sample_time, Timing.HELD))
    return ji.Record(reference=ji.Channel(reference, position, sample_time), injected=added)


def predict_test(
    loop: ji.ClosedLoop, values: Mapping[str, float], test: ji.Record, noise: Noise, *, runs: int = RUNS, **more: Any
) -> PredictedTest:
    """Predict a test of a joint with known values."""
    asked = {"filtering": ji.Filtering(), "parameters": {}} | more
    model = JointModel(
        loop, (values,), noise, len(test.reference), test.reference.sample_time, injection=True, present=(), **asked
    )
    return next(model.predict((test,), runs))
