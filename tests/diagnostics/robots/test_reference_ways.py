"""Ways of the references of a robot's joints, whose drives are faster than the log, found without a motor position."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from tests.robots_plants import two

CUBIC, MEAN = {"interpolation": "cubic"}, {"reference_average": 4e-3}


def identified(ways):
    """Return the diagnosis under lines of drives at 4 kHz with these ways."""
    twin = two()
    driven, declared = twin.records(3.0), [replace(law, period=2.5e-4) for law in twin.loop().controllers]
    true = tuple(replace(law, **way) for law, way in zip(declared, ways, strict=True))
    made = ji.simulate(ji.robots.RobotLoop(twin.robot, true), driven).records(driven)
    draw, logs = np.random.default_rng(0), []
    for one in made:
        values = one.torque.values + 0.01 * np.std(one.torque.values) * draw.standard_normal(one.torque.values.size)
        logs.append(replace(one, torque=replace(one.torque, values=values), motor_position=None))
    return ji.identify(logs, ji.robots.RobotLoop(twin.robot, tuple(declared)), ji.DIDIM()).diagnosis


@pytest.mark.slow
@pytest.mark.parametrize(
    ("ways", "named"),
    [([CUBIC, {}], ["cubic_reference", None]), ([{}, MEAN], [None, "averaged_reference"]), ([{}, {}], [None, None])],
)
def test_what_a_drive_does_with_its_reference_is_named_at_its_joint(ways, named):
    axes = [[one.test.name for one in axis.faults.findings] for axis in identified(ways).axes]
    assert [each[0] if each else None for each in axes] == named
