"""Flexible joints whose spring or friction is smooth, identified from torque and reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.common.errors import MethodError
from jointid.diagnostics.friction_comparison import compare_frictions
from jointid.estimation.identify import identify
from jointid.estimation.methods.idim import IDIM
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.ripple import PositionHarmonics
from jointid.models.springs import SPRINGS
from jointid.simulation.closed_loop import simulate
from jointid.simulation.loop_input import prepare
from tests.estimation.test_stribeck import noisy
from tests.plants import Case, prismatic

LAWS = ("presliding", "load-dependent", "drifting", "cubic", "hysteretic", "elastic-load", "ripple")


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


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_flexible_joint_tells_its_law(law: str) -> None:
    case = prismatic(1)
    loop, values = with_law(case, law)
    found = identify(noisy(case, loop, values), loop)
    assert abs(found["stiffness"].value - values["stiffness"]) < 3 * found["stiffness"].stderr
    for p in found.params:
        if p.of_joint and p.identifiable and p.value is not None and p.stderr:
            assert abs(p.value - values[p.name]) < 4.5 * p.stderr, p.name


@pytest.mark.slow
def test_the_record_shows_that_its_friction_winds_up() -> None:
    case = prismatic(1)
    loop, values = with_law(case, "presliding")
    found = compare_frictions(noisy(case, loop, values), case.loop)
    assert found.shown.name == "presliding"
    assert found.sentence.endswith('; set joint.friction = "presliding" to identify it.')


def test_what_takes_friction_for_a_line_refuses_it() -> None:
    case = prismatic(1)
    joint = FlexibleJoint(friction=FRICTIONS["presliding"]())
    with pytest.raises(MethodError, match=r'IDIM takes friction for one line .* received the law "presliding"'):
        identify(case.clean, joint, IDIM())
