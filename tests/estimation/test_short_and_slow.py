"""Records of two seconds and loops of a third of a hertz: little to begin a search with, enough to end one."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest

import jointid as ji
from jointid.paper.twin import TABLE_2, twin
from studies.healthy import drive


def cut(record: ji.Record, first: int, count: int) -> ji.Record:
    """Return samples of a record's torque, reference and injected signal."""

    def of(channel: ji.Channel) -> ji.Channel:
        return replace(channel, values=channel.values[first : first + count])

    assert record.torque is not None
    assert record.reference is not None
    assert record.injected is not None
    injected = replace(record.injected, channel=of(record.injected.channel))
    return ji.Record(torque=of(record.torque), reference=of(record.reference), injected=injected)


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_two_seconds_of_an_axis_that_moves_are_enough(seed: int) -> None:
    axis = twin("L19", noise="white", seed=seed)
    estimate = ji.identify(cut(axis.record, 3000, 2000), axis.loop, checks=False)
    line = estimate["stiffness"]
    assert line.value is not None
    assert line.stderr is not None
    assert line.value == pytest.approx(TABLE_2["stiffness"], abs=3 * line.stderr)
    assert line.stderr < 0.03 * line.value


def test_steps_that_lead_to_no_joint_give_way_to_least_squares() -> None:
    """A rigid joint of a flexible axis, from four seconds: much is not explained, and said not to be."""
    axis = twin("L19", noise="white")
    rigid = ji.ClosedLoop(axis.loop.joint.rigid, axis.loop.controller)  # type: ignore[union-attr]
    said: list[str] = []
    estimate = ji.identify(
        cut(axis.record, 3000, 4000), rigid, ji.DIDIM("residual"), checks=False, progress=said.append
    )
    assert any("searching by least squares" in line for line in said)
    assert "by least squares" in estimate.settings.variant
    for name in ("inertia", "coulomb"):
        value = estimate[name].value
        assert value is not None
        assert value >= 0.0
    with pytest.raises(ji.MethodError, match="DIDIM cannot go on"):
        ji.identify(cut(axis.record, 3000, 4000), rigid, ji.DIDIM("paper"), checks=False)


def test_a_loop_of_a_third_of_a_hertz_is_identified() -> None:
    pace = 2 * math.pi * 0.3
    law = ji.controller.Cascade(position_gain=0.25 * pace, velocity_gain=0.5 * pace, period=1e-3)
    mode = 3 * pace
    truth = {
        "motor_inertia": 0.25, "motor_viscous": 0.03, "motor_coulomb": 0.05, "stiffness": 0.125 * mode**2,
        "damping": 0.04 * 0.125 * mode, "load_inertia": 0.25, "load_viscous": 0.02, "load_coulomb": 0.05,
        "offset": 0.02,
    }  # fmt: skip
    loop = ji.ClosedLoop(ji.FlexibleJoint("revolute"), law)
    reference = ji.excitation.trapezoids((1.0, 2.0), 2.0, 2.0, 1e-3, duration=40.0)
    record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
    found = ji.identify(record.without("motor_position", "load_position"), loop, checks=False)
    assert found["stiffness"].value == pytest.approx(truth["stiffness"], rel=1e-6)


@pytest.mark.slow
def test_a_mode_inside_the_bandwidth_is_found_though_the_rigid_joint_is_none() -> None:
    """The load is 84 % of the inertia: no flexible joint of the inertia that a rigid one shows can be simulated."""
    axis = drive(9247, 12.0)
    said: list[str] = []
    estimate = ji.identify(axis.record, axis.loop, checks=False, progress=said.append)
    assert any("with other inertias than that joint's" in line for line in said)
    stiffness = estimate["stiffness"]
    assert stiffness.interval is not None
    assert stiffness.interval[0] < axis.truth["stiffness"] < stiffness.interval[1]
