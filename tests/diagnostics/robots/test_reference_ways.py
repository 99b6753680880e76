"""Ways of the references of a robot's joints, whose drives are faster than the log, found without a motor position."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.uncertainty.verdict import Status, Subject
from tests.robots_plants import two

HOLD, CUBIC, MEAN = {"interpolation": "hold"}, {"interpolation": "cubic"}, {"reference_average": 4e-3}


def identified(ways, noise=0.01, duration=3.0):
    """Return the estimate under lines, and the verdict on the loop, of drives at 4 kHz with these ways."""
    twin = two()
    driven, declared = twin.records(duration), [replace(law, period=2.5e-4) for law in twin.loop().controllers]
    true = tuple(replace(law, **way) for law, way in zip(declared, ways, strict=True))
    made = ji.simulate(ji.robots.RobotLoop(twin.robot, true), driven).records(driven)
    draw, logs = np.random.default_rng(0), []
    for one in made:
        values = one.torque.values + noise * np.std(one.torque.values) * draw.standard_normal(one.torque.values.size)
        logs.append(replace(one, torque=replace(one.torque, values=values), motor_position=None))
    found = ji.identify(logs, ji.robots.RobotLoop(twin.robot, tuple(declared)), ji.DIDIM())
    (loop,) = (one for one in found.checks.verdicts if one.subject is Subject.LOOP)
    return found, loop


@pytest.mark.slow
def test_cubics_are_named_at_their_joint():
    found, loop = identified([CUBIC, {}])
    assert loop.status is Status.FAILED
    assert loop.said.startswith("joint1: the reference is interpolated by cubics between its samples: declare interp")
    assert found.checks.diagnosis.axes[1].faults.as_declared
    shift = found.checks.diagnosis.axes[0].faults.findings[0].changes["Iyy1"]
    assert shift.sigmas > 2 or shift.sigmas < -2


@pytest.mark.slow
@pytest.mark.parametrize("ways", [[{}, MEAN], [HOLD, HOLD]])
def test_a_reference_that_is_held_or_averaged_is_named_at_its_joints(ways):
    found, loop = identified(ways)
    assert loop.status is Status.FAILED
    for axis, way in zip(found.checks.diagnosis.axes, ways, strict=True):
        said = axis.faults.sentences[0]
        assert axis.faults.as_declared is (not way)
        if way:
            assert said.startswith("the reference is held") if way is HOLD else "averages the reference over " in said


@pytest.mark.slow
def test_drives_that_do_as_declared_have_no_fault_and_what_is_not_excluded_is_said():
    found, loop = identified([{}, {}])
    assert loop.status is Status.UNKNOWN and "may be" not in loop.said
    assert all(axis.faults.as_declared for axis in found.checks.diagnosis.axes)
    noisy, loop = identified([{}, {}], noise=0.05)
    assert loop.status is Status.UNKNOWN and "it may be that the reference is interpolated by cubics" in loop.said
    assert noisy.checks.diagnosis.as_declared is not False
