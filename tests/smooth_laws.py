"""Drives with a smooth law that shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.models.friction import FRICTIONS
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


def with_law(case: Case, law: str) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with a law that shows, and its values."""
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    own = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    assert own.load_position is not None
    windup = float(np.max(np.abs(own.motor_position - own.load_position)))
    travel, stiffness = float(np.ptp(own.motor_position)), case.truth["stiffness"]
    duration = own.torque.size * own.sample_time
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
        "ripple": {"harmonic_1_cosine": 0.1 * stiffness * windup, "harmonic_1_sine": -0.05 * stiffness * windup},
    }[law]  # fmt: skip
    if law == "ripple":
        other = replace(joint, ripple=PositionHarmonics(0.1 * travel))
    else:
        other = replace(joint, friction=FRICTIONS[law]()) if law in FRICTIONS else replace(joint, spring=SPRINGS[law]())
    return replace(case.loop, joint=other), case.truth | more
