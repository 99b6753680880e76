"""What a simulation in steps does at its edges: rests, dips, limits, bounds and laws that hardly act."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import with_numbers
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.springs import SPRINGS
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from tests.plants import Case, prismatic, rotary, with_law
from tests.simulation.differences import error_beside_differences, sensitivities

_STEP = 3e-6


def _nothing_more(case: Case, friction: str = "drifting", spring: str = "cubic") -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with smooth laws that add nothing to what it is."""
    joint = replace(case.loop.joint, friction=FRICTIONS[friction])
    if isinstance(joint, FlexibleJoint):
        joint = replace(joint, spring=SPRINGS[spring])
    more = {p.name: 0.0 for p in joint.parameters if p.name not in case.truth}
    return replace(case.loop, joint=joint), case.truth | more


@pytest.mark.parametrize("make", [prismatic, rotary])
def test_friction_that_winds_up_over_next_to_nothing_is_coulombs(make: Callable[[int], Case]) -> None:
    """However stiff it then is; what it differs by is the motion of a mass that it holds, as the root of its length."""
    case = make(1)
    exact = simulate(case.loop, prepare(case.loop, case.clean), case.truth)
    loop = replace(case.loop, joint=replace(case.loop.joint, friction=FRICTIONS["presliding"]))
    for share, within in ((1e-6, 5e-2), (1e-9, 2e-3), (1e-12, 5e-5)):
        length = share * float(np.ptp(exact.motor_position))
        values = case.truth | {"motor_presliding_distance": length, "load_presliding_distance": length}
        found = simulate(loop, prepare(loop, case.clean), values)
        assert found.outcome is Outcome.FINISHED
        assert np.abs(found.torque - exact.torque).max() < within * np.abs(exact.torque).max()


@pytest.mark.parametrize("name", ["damping", "load_coulomb"])
def test_a_number_at_its_bound_has_the_derivative_to_the_side_of_joints(name: str) -> None:
    case = prismatic(1)
    loop, values = _nothing_more(case)
    experiment, at = prepare(loop, case.clean), {name: 0.0}
    exact = sensitivities(case.loop, experiment, case.truth | at, [name]).torque
    found = sensitivities(loop, experiment, values | at, [name]).torque
    assert np.linalg.norm(exact) > 1.0
    assert np.linalg.norm(found - exact) < 0.05 * np.linalg.norm(exact)


def test_a_load_that_begins_to_swing_in_motion_has_the_derivative_of_differences() -> None:
    case, start = prismatic(1), Initial(velocity=0.2)
    loop, values = _nothing_more(case, "symmetric", "elastic-load")
    found = sensitivities(loop, prepare(loop, case.clean), values, ["swinging_share"], start).torque[:, 0]
    at = loop, case.clean, values, "swinging_share", (1e-6,), start
    assert error_beside_differences((found,), *at, back=0.0) < 1e-4


def test_a_gap_of_nothing_is_a_linear_spring() -> None:
    case = prismatic(1)
    loop, values = _nothing_more(case, "symmetric", "backlash")
    exact, found = (simulate(one, prepare(one, case.clean), values).torque for one in (case.loop, loop))
    assert np.abs(found - exact).max() < 1e-6 * np.abs(exact).max()


def test_friction_that_grows_with_the_load_is_in_balance_at_the_first_sample() -> None:
    law = FRICTIONS["load-dependent"]
    values = {"load_viscous": 0.0, "load_coulomb": 2.0, "load_friction_per_torque": 0.2}
    for velocity, load in ((1.0, 50.0), (-1.0, 50.0), (1.0, -50.0), (-1.0, 0.5)):
        drag = law.drag(values, velocity, load, "load_")
        assert drag == pytest.approx(np.sign(velocity) * (2.0 + 0.2 * abs(load + drag)))


@pytest.mark.parametrize(("velocity", "bound"), [(0.0, 1e-3), (1e-9, 2e-3), (1e-5, 10.0), (0.1, 1e-3)])
def test_only_what_moves_has_wound_up_at_the_first_sample(velocity: float, bound: float) -> None:
    case = prismatic(1)
    loop = replace(case.loop, joint=replace(case.loop.joint, friction=FRICTIONS["presliding"]))
    values = case.truth | {"motor_presliding_distance": 1e-4, "load_presliding_distance": 1e-4}
    found = simulate(loop, prepare(loop, case.clean), values, Initial(velocity=velocity))
    rest = simulate(loop, prepare(loop, case.clean), values)
    slides = simulate(case.loop, prepare(case.loop, case.clean), case.truth, Initial(velocity=velocity))
    error = found.torque - rest.torque if velocity < 0.1 else (found.torque - slides.torque)[:5]  # until it turns
    assert np.abs(error).max() <= bound


def test_a_delay_moves_no_edge_of_a_torque_that_goes_on() -> None:
    case = prismatic(1)
    controller = with_numbers(case.loop.controller, {"integral_gain": 5.0})
    plain = replace(case.loop, controller=controller)
    drifting, values = with_law(replace(case, loop=plain), "drifting")
    values = {name: value if name in case.truth else 0.0 for name, value in values.items()}
    begin = Initial(velocity=0.1, torque=71.7)
    exact, found = (
        sensitivities(loop, prepare(loop, case.clean), values, ["delay"], begin).torque for loop in (plain, drifting)
    )
    assert np.linalg.norm(found - exact) <= 1e-5 * np.linalg.norm(exact)


def test_a_slider_without_stiffness_has_a_derivative_by_it() -> None:
    case = prismatic(1)
    loop, values = with_law(case, "hysteretic")
    experiment, name, columns = prepare(loop, case.clean), "hysteresis_stiffness", []
    for stiffness in (0.0, 1e-5 * values["stiffness"]):
        columns.append(sensitivities(loop, experiment, values | {name: stiffness}, [name]).torque)
    assert np.linalg.norm(columns[1] - columns[0]) <= 1e-3 * np.linalg.norm(columns[1])


@pytest.mark.parametrize("share", [1e-4, 1e-5])
def test_friction_that_winds_up_within_a_sample_is_followed(share: float) -> None:
    case = prismatic(1)
    loop, values = with_law(case, "presliding")
    experiment = prepare(loop, case.clean)
    length = share * float(np.ptp(case.clean.reference.values))  # type: ignore[union-attr]
    values = values | {"motor_presliding_distance": length, "load_presliding_distance": 0.7 * length}
    found = sensitivities(loop, experiment, values, list(values))
    for i, name in enumerate(values):
        step = _STEP * (abs(values[name]) or 1e-3)
        error = error_beside_differences((found.torque[:, i],), loop, case.clean, values, name, (step,))
        assert error <= 5e-3, name
