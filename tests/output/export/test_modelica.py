"""Modelica, parsed by pymoca and run by an interpreter that knows nothing of joints: the torque is ours."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.models.friction import FRICTIONS
from jointid.models.joints import Joint
from jointid.models.position_forces import PositionHarmonics
from jointid.models.springs import SPRINGS, Backlash, Spring, ThreePieceSpring
from jointid.paper.twin import CONTROLLERS, TABLE_2
from tests.geared import FLEXIBLE, LAW, RIGID, TURNED_SCREW
from tests.output.export.modelica_reader import ModelicaModel
from tests.output.export.models import PIECES, SMOOTH, apart, model, servo, simulated

REFERENCE = ji.excitation.trapezoids((0.042, 0.125), 0.83, 0.05, 1e-3, duration=2.0)


def torque_of(
    joint: Joint,
    values: Mapping[str, float],
    law: ji.controller.Cascade,
    reference: np.ndarray,
    side: str | None = None,
    to_side: float = 1.0,
    steps: int = 4,
) -> np.ndarray:
    """The torque of the loop around the exported model; `to_side` takes the joint's torque to the exported side."""
    text = ji.export(model(joint, values), "modelica", side=side).text
    start = float(reference[0]) / to_side
    states = {"motor_position": start} | ({"load_position": start} if joint.model == "flexible" else {})
    plant = ModelicaModel(text, "axis", **states)

    def held(torque: float) -> float:
        plant.advance(1e-3, steps, torque=to_side * torque)
        return to_side * plant.values["motor_position"]

    return servo(law, reference, 1e-3, held)


def test_the_twin_s_torque_is_ours_to_the_last_digits_through_reversals_and_rests() -> None:
    law = CONTROLLERS["L19"]
    ours = simulated(ji.FlexibleJoint("prismatic"), law, REFERENCE, TABLE_2)
    assert apart(torque_of(ji.FlexibleJoint("prismatic"), TABLE_2, law, REFERENCE), ours) < 1e-6


@pytest.mark.slow
def test_asymmetric_friction_and_a_link_s_weight_are_told_whole() -> None:
    weight = ji.Gravity("link", ji.spring.Counterbalance(cos=0.2, rate=0.05))
    joint = ji.RigidJoint("revolute", ji.friction.AsymmetricFriction(), gravity=weight)
    law = ji.controller.Cascade(position_gain=30.0, velocity_gain=2.0)
    values = {
        "inertia": 0.04, "viscous_forwards": 0.05, "coulomb_forwards": 0.1, "viscous_backwards": 0.08,
        "coulomb_backwards": 0.16, "gravity_cos": 0.6, "gravity_sin": -0.2, "offset": 0.0, "counterbalance_cos": 0.2,
        "counterbalance_rate": 0.05,
    }  # fmt: skip
    reference = ji.excitation.trapezoids([0.5, 2.0], 8.0, 1.0, 1e-3, duration=3.0)
    ours = simulated(joint, law, reference, values)
    # Our own simulation holds what gravity is over each period.
    assert apart(torque_of(joint, values, law, reference), ours) < 2e-5


def test_a_weight_pulls_down_and_its_counterbalance_up() -> None:
    joint = ji.RigidJoint(
        "revolute", gravity=ji.Gravity("link", ji.spring.Counterbalance(cos=0.2, rate=0.05), angle=0.5)
    )
    values = {"inertia": 0.04, "viscous": 0.0, "coulomb": 0.0, "offset": 0.0, "gravity_cos": 0.6, "gravity_sin": -0.2}
    values |= {"counterbalance_cos": 0.2, "counterbalance_rate": 0.05}
    plant = ModelicaModel(ji.export(model(joint, values), "modelica").text, "axis", motor_position=0.7)
    plant.advance(1e-6, 1, torque=1.0)
    gains = 1.0 - (0.6 * math.cos(0.35) - 0.2 * math.sin(0.35)) + (0.2 * math.cos(0.35) + 0.05 * 0.7)
    assert plant.values["motor_velocity"] == pytest.approx(1e-6 * gains / 0.04, rel=1e-5)


@pytest.mark.parametrize(
    ("made", "values"), [(ji.RigidJoint, RIGID), pytest.param(ji.FlexibleJoint, FLEXIBLE, marks=pytest.mark.slow)]
)
def test_the_other_side_of_a_screw_that_turns_round_gives_the_same_torque(
    made: type[ji.RigidJoint | ji.FlexibleJoint], values: Mapping[str, float]
) -> None:
    transmission = ji.Transmission(load="prismatic", lead=0.010, sign=-1, side="motor")
    assert transmission.motor_per_load == TURNED_SCREW.motor_per_load
    joint = made("revolute", transmission=transmission)
    reference = ji.excitation.trapezoids([20.0, 60.0], 800.0, 20.0, 1e-3, duration=2.0)
    ours = simulated(joint, LAW, reference, values)
    there = torque_of(joint, values, LAW, reference, "load", TURNED_SCREW.motor_per_load)
    assert apart(there, ours) < 1e-6


@pytest.mark.slow
def test_a_ripple_seen_from_the_other_side_of_a_turned_screw_gives_the_same_torque() -> None:
    transmission = ji.Transmission(load="prismatic", lead=0.010, sign=-1, side="motor")
    joint = ji.RigidJoint("revolute", transmission=transmission, ripple=PositionHarmonics(3.0, 2))
    values = RIGID | {"harmonic_1_cosine": 0.1, "harmonic_1_sine": 0.3, "harmonic_2_cosine": 0.0}
    values |= {"harmonic_2_sine": -0.2}
    reference = ji.excitation.trapezoids([20.0, 60.0], 800.0, 20.0, 1e-3, duration=2.0)
    ours = simulated(joint, LAW, reference, values)
    there = torque_of(joint, values, LAW, reference, "load", TURNED_SCREW.motor_per_load)
    assert apart(there, ours) < 1e-4
    assert apart(simulated(replace(joint, ripple=None), LAW, reference, RIGID), ours) > 0.01


def test_what_was_identified_stands_in_it_and_a_hostile_name_does_not_break_it() -> None:
    name = 'axis"; end axis;\nmodel evil // */'
    record = 'run\u2028"7"\nend x; \\'
    text = ji.export(model(ji.FlexibleJoint("prismatic"), TABLE_2, name, record), "modelica").text
    assert text.startswith("model axis_end_axis_model_evil ")
    plant = ModelicaModel(text, "axis_end_axis_model_evil")
    for parameter, value in TABLE_2.items():
        assert plant.values[parameter] == value
    assert all(line.startswith("  //") for line in text.splitlines() if "run" in line)
    assert ModelicaModel(
        ji.export(model(ji.FlexibleJoint("prismatic"), TABLE_2, "model"), "modelica").text, "joint_model"
    )


@pytest.mark.slow
@pytest.mark.parametrize("spring", [Backlash(), ThreePieceSpring()], ids=["backlash", "three-piece"])
def test_a_spring_in_pieces_gives_our_torque(spring: Spring) -> None:
    joint, law = ji.FlexibleJoint("prismatic", spring=spring), CONTROLLERS["L19"]
    reference = REFERENCE[:400]
    ours = simulated(joint, law, reference, PIECES)
    coarse, fine = (apart(torque_of(joint, PIECES, law, reference, steps=steps), ours) for steps in (4, 16))
    assert fine < 3e-5  # the interpreter steps over the edges of the pieces
    assert fine < 0.5 * coarse
    assert apart(simulated(ji.FlexibleJoint("prismatic"), law, reference, PIECES), ours) > 0.01


@pytest.mark.parametrize(
    "law",
    [
        *(pytest.param(law, marks=pytest.mark.slow) for law in ("cubic", "presliding", "load-dependent", "drifting")),
        "hysteretic",
        "presliding-load-dependent",
        "elastic-load",
        "ripple",
    ],
)
def test_a_smooth_law_gives_our_torque(law: str) -> None:
    whole = ji.FlexibleJoint("prismatic")
    if law == "ripple":
        joint = replace(whole, ripple=PositionHarmonics(0.02, 2))
    else:
        joint = replace(whole, spring=SPRINGS[law]()) if law in SPRINGS else replace(whole, friction=FRICTIONS[law]())
    reference = REFERENCE[:400]
    ours = simulated(joint, CONTROLLERS["L19"], reference, SMOOTH)
    assert apart(torque_of(joint, SMOOTH, CONTROLLERS["L19"], reference, steps=8), ours) < 1e-4
    assert apart(simulated(whole, CONTROLLERS["L19"], reference, SMOOTH), ours) > 0.01


@pytest.mark.parametrize("law", ["load-dependent", "asymmetric-load-dependent", "presliding-load-dependent"])
def test_the_friction_of_a_rigid_joint_grows_with_the_motor_s_torque(law: str) -> None:
    joint, loop = (
        ji.RigidJoint("revolute", FRICTIONS[law]()),
        ji.controller.Cascade(position_gain=30.0, velocity_gain=2.0),
    )
    values = {"inertia": 0.04, "viscous": 0.05, "coulomb": 0.1, "offset": 0.05, "friction_per_torque": 0.15}
    values |= {"presliding_distance": 0.02, "viscous_forwards": 0.05, "coulomb_forwards": 0.1}
    values |= {"viscous_backwards": 0.08, "coulomb_backwards": 0.16}
    values = {p.name: values[p.name] for p in joint.parameters}
    reference = 0.3 * np.sin(15.0 * np.arange(400) * 1e-3) ** 3
    ours = simulated(joint, loop, reference, values)
    assert apart(torque_of(joint, values, loop, reference, steps=8), ours) < 1e-3
    assert apart(simulated(joint, loop, reference, values | {"friction_per_torque": 0.0}), ours) > 0.02


def test_pieces_that_do_not_follow_each_other_are_refused() -> None:
    joint = ji.FlexibleJoint("prismatic", spring=ThreePieceSpring())
    for wrong in ({"torque_2": 10.0}, {"stiffness_2": 0.0}, {"stiffness_2": -1.0}):
        with pytest.raises(ji.MethodError, match="expected pieces that follow each other"):
            ji.export(model(joint, PIECES | wrong), "modelica")
