"""Drives with a law that is no line, and that shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.models.friction import FRICTIONS, StribeckFriction
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.models.springs import SPRINGS
from jointid.simulation.closed_loop import simulate
from jointid.simulation.loop_input import prepare
from tests.plants import Case

LAWS = (
    "presliding",
    "load-dependent",
    "presliding-load-dependent",
    "drifting",
    "cubic",
    "hysteretic",
    "elastic-load",
    "ripple",
)
"""Smooth laws."""
PIECES = ("stribeck", "three-piece", "backlash")
"""Laws in pieces."""


def with_law(case: Case, law: str) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with a law that shows, and its values."""
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    own = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    assert own.load_position is not None
    windup = float(np.max(np.abs(own.motor_position - own.load_position)))
    travel, stiffness = float(np.ptp(own.motor_position)), case.truth["stiffness"]
    duration, fastest = own.torque.size * own.sample_time, float(np.max(np.abs(own.motor_velocity)))
    more = {
        "presliding": {"motor_presliding_distance": 3e-3 * travel, "load_presliding_distance": 2e-3 * travel},
        "load-dependent": {"load_friction_per_torque": 0.15},
        "presliding-load-dependent": {
            "motor_presliding_distance": 3e-3 * travel, "load_presliding_distance": 2e-3 * travel,
            "load_friction_per_torque": 0.15,
        },
        "drifting": {
            "motor_viscous_drift": -0.4 * case.truth["motor_viscous"] / duration,
            "load_viscous_drift": -0.4 * case.truth["load_viscous"] / duration,
            "motor_coulomb_drift": -0.3 * case.truth["motor_coulomb"] / duration,
            "load_coulomb_drift": -0.2 * case.truth["load_coulomb"] / duration,
        },
        "cubic": {"cubic_stiffness": 0.6 * stiffness / windup**2},
        "hysteretic": {"hysteresis_stiffness": 0.5 * stiffness, "hysteresis_torque": 0.1 * stiffness * windup},
        "elastic-load": {
            "swinging_share": 0.4, "swinging_stiffness": 2.5 * stiffness, "swinging_damping": case.truth["damping"]
        },
        "stribeck": {f"{side}_stribeck_force": 0.4 * case.truth[f"{side}_coulomb"] for side in ("motor", "load")}
        | {f"{side}_stribeck_speed": 0.05 * fastest for side in ("motor", "load")},
        "three-piece": {
            "stiffness": 0.6 * stiffness, "stiffness_2": stiffness, "stiffness_3": 1.4 * stiffness,
            "torque_1": 0.3 * stiffness * windup, "torque_2": 0.6 * stiffness * windup,
        },
        "backlash": {"gap": 0.5 * windup},
        "ripple": {"harmonic_1_cosine": 0.1 * stiffness * windup, "harmonic_1_sine": -0.05 * stiffness * windup},
    }[law]  # fmt: skip
    if law == "ripple":
        other = replace(joint, ripple=PositionHarmonics(0.1 * travel))
    else:
        other = replace(joint, friction=FRICTIONS[law]()) if law in FRICTIONS else replace(joint, spring=SPRINGS[law]())
    return replace(case.loop, joint=other), case.truth | more


RISES = {"stribeck_force": 0.4, "stribeck_speed": 0.05}  # of the Coulomb friction, and of the largest speed
FALLS = {"stribeck_force": -0.4, "stribeck_speed": 0.05}


def slow(case: Case, shares: dict[str, float]) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with another friction towards standstill."""
    joint = case.loop.joint
    own = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    values = dict(case.truth)
    for prefix in ("motor_", "load_") if isinstance(joint, FlexibleJoint) else ("",):
        values[f"{prefix}stribeck_force"] = shares["stribeck_force"] * values[f"{prefix}coulomb"]
        values[f"{prefix}stribeck_speed"] = shares["stribeck_speed"] * float(np.max(np.abs(own.motor_velocity)))
    return replace(case.loop, joint=replace(joint, friction=StribeckFriction())), values


def rigid(case: Case) -> Case:
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    return replace(case, loop=replace(case.loop, joint=joint.rigid), truth=joint.rigid_sums(case.truth))
