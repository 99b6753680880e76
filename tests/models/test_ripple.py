"""A ripple over the position, and a load that swings in itself, wherever a joint is taken for something else."""

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.models.joints import FlexibleJoint, RigidJoint, of_whole
from jointid.models.linear import frequency_response, linear_joints
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.models.springs import Spring
from jointid.paper.twin import TABLE_2
from jointid.planning.joints import _holding_torque
from jointid.simulation.drive_side import PARTS, prescribe, run_drive_side
from jointid.simulation.plant import Numbers, Place
from jointid.simulation.start import steady_joint

RIGID = {"inertia": 100.0, "viscous": 200.0, "coulomb": 20.0, "offset": -3.0}
WAVED = {"harmonic_1_cosine": 8.0, "harmonic_1_sine": -5.0}
RIPPLE = PositionHarmonics(0.02)
SWINGS = {"swinging_share": 0.4, "swinging_stiffness": 9e5, "swinging_damping": 30.0}


def test_a_ripple_on_the_load_is_one_of_the_whole_where_the_spring_does_not_give() -> None:
    joint = FlexibleJoint("prismatic", ripple=replace(RIPPLE, side="load"))
    assert joint.rigid == RigidJoint("prismatic", ripple=RIPPLE)
    values = TABLE_2 | {f"load_{name}": value for name, value in WAVED.items()}
    found = {p.name: of_whole(p, values) for p in joint.rigid.parameters}
    assert {name: found[name] for name in WAVED} == WAVED
    assert joint.linear == FlexibleJoint("prismatic")
    assert RigidJoint("prismatic", ripple=RIPPLE).flexible == FlexibleJoint("prismatic", ripple=RIPPLE)


@pytest.mark.parametrize("spring", ["linear", "cubic", "elastic-load"])
def test_the_spring_carries_the_ripple_of_a_load_at_rest(spring: str) -> None:
    joint = FlexibleJoint("prismatic", ripple=replace(RIPPLE, side="load"), spring=Spring(spring))
    values = TABLE_2 | SWINGS | {"cubic_stiffness": 0.0, "load_harmonic_1_cosine": 80.0, "load_harmonic_1_sine": 0.0}
    hung = steady_joint(Numbers.of_joint(joint, values), 0.0, 0.0, 0.0).settle()[0][1]
    force = 80.0 * np.cos(2 * np.pi / RIPPLE.period * hung)
    assert -hung == pytest.approx(force / TABLE_2["stiffness"])


@pytest.mark.parametrize("stiffness", [20.0, 90.0, 500.0])
def test_a_load_hangs_where_the_spring_holds_it_however_soft_it_is(stiffness: float) -> None:
    joint = FlexibleJoint("revolute", gravity=Gravity("link"))
    values = dict.fromkeys((p.name for p in joint.parameters), 0.0) | {"stiffness": stiffness, "gravity_cos": 100.0}
    hung = steady_joint(Numbers.of_joint(joint, values), -1.57, 0.0, 0.0).settle()[0][1]
    assert stiffness * (hung + 1.57) == pytest.approx(-100.0 * np.cos(hung), abs=1e-9)


def test_the_drive_side_has_the_ripple_of_the_motor() -> None:
    t = np.arange(4000) * 1e-3
    q = 0.05 * np.sin(2 * np.pi * 0.7 * t)
    motion = prescribe(q[:, np.newaxis], 1e-3, PARTS)
    run = run_drive_side(motion, Numbers.of_joint(RigidJoint("prismatic", ripple=RIPPLE), RIGID | WAVED))
    plain = run_drive_side(motion, Numbers.of_joint(RigidJoint("prismatic"), RIGID))
    columns = RIPPLE.columns(run.motion.position[:, 0])
    np.testing.assert_allclose((run.torque - plain.torque)[:, 0], columns @ list(WAVED.values()), atol=1e-9)
    np.testing.assert_allclose(run.columns([Place(0, name) for name in WAVED])[0][1], columns)


def test_what_holds_a_joint_holds_it_on_its_ripple() -> None:
    axis = ji.twin()
    loop = ji.ClosedLoop(RigidJoint("prismatic", ripple=RIPPLE), axis.loop.controller)
    assert _holding_torque(loop, RIGID | WAVED, 0.0) == pytest.approx(-3.0 + 8.0)
    assert _holding_torque(loop, RIGID | WAVED, 0.005) == pytest.approx(-3.0 - 5.0)


def test_modes_and_response_of_an_elastic_load_are_those_of_three_masses() -> None:
    joint, values = FlexibleJoint("prismatic", spring=Spring("elastic-load")), TABLE_2 | SWINGS
    A = linear_joints(joint, [values]).A[0]
    undamped = linear_joints(joint, [values | dict.fromkeys(
        ("motor_viscous", "load_viscous", "damping", "swinging_damping"), 0.0
    )]).A[0]  # fmt: skip
    poles = np.unique(np.round(np.abs(np.linalg.eigvals(undamped)) / (2 * np.pi), 6))
    modes = joint.frequencies(values)
    np.testing.assert_allclose(poles[-2:], [modes["free_free"], modes["second_free_free"]], rtol=1e-6)
    assert A.shape == (6, 6)
    hertz = np.array([modes["motor_locked"] * 0.5, modes["second_free_free"]])
    rigid_part = frequency_response(FlexibleJoint("prismatic"), TABLE_2, hertz)
    none = frequency_response(joint, TABLE_2 | SWINGS | {"swinging_share": 0.0}, hertz)
    np.testing.assert_allclose(none, rigid_part)
    assert frequency_response(joint, values, hertz)[1].real > 20 * rigid_part[1].real  # a peak, in phase


def test_a_counterbalance_is_a_spring_to_the_ground_in_the_response() -> None:
    joint = RigidJoint("revolute", gravity=Gravity("constant", Counterbalance(rate=-800.0)))
    values, s = RIGID | {"gravity_constant": 5.0, "counterbalance_rate": -800.0}, 2j * np.pi * np.array([0.1, 3.0])
    found = frequency_response(joint, values, np.abs(s) / (2 * np.pi), "motor_position")
    np.testing.assert_allclose(found, 1.0 / (100.0 * s**2 + 200.0 * s + 800.0))


def test_an_elastic_load_begins_its_search_as_stiff_as_the_linear_spring() -> None:
    starts = list(Spring("elastic-load").starts(TABLE_2, 1e-4))
    assert len(starts) == 4
    for start in starts:
        both = 1 / start["stiffness"] + start["swinging_share"] ** 2 / start["swinging_stiffness"]
        assert both == pytest.approx(1 / TABLE_2["stiffness"])
