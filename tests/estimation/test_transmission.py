"""An axis behind a gear is the same on either side of it, and in any units: to rounding, in as many simulations."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from jointid.common.transmission import Transmission
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.estimate import Estimate, EstimatedParameter
from jointid.models.friction import Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.models.position_forces import PositionHarmonics
from jointid.output.export.joint_model import on_other_side
from jointid.records.record import Channel, Record
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.synthesis import simulated_record
from tests.estimates import identify
from tests.geared import FLEXIBLE, RATE, RIGID, SCREW
from tests.geared import LAW as UNFILTERED

TURNED = Transmission(load="revolute", ratio=100.0, sign=-1)
LAW = replace(UNFILTERED, velocity_filter=(0.5, 0.5))

CLOSE = 1e-9
"""How far answers may differ, relative."""

RIGID_ASYMMETRIC = {"inertia": 2e-4, "viscous_forwards": 1e-3, "coulomb_forwards": 0.03, "offset": 0.0}
RIGID_ASYMMETRIC |= {"viscous_backwards": 1.4e-3, "coulomb_backwards": 0.04}


def joint_of(model: str, gear: Transmission | None, friction: str = "symmetric") -> Joint:
    law = Friction() if friction == "symmetric" else Friction("asymmetric")
    made = RigidJoint if model == "rigid" else FlexibleJoint
    return made("revolute" if gear is None else gear.kind, law, None, gear)


@cache
def logged(model: str, friction: str = "symmetric") -> Record:
    """Return a noisy record of the axis on the motor's side: rad and N m."""
    values = {"rigid": RIGID, "flexible": FLEXIBLE}[model]
    values = values if friction == "symmetric" else RIGID_ASYMMETRIC
    reference = trapezoids((30.0, 60.0), 400.0, 30.0, RATE, duration=4.0)
    known = pulses(reference.size, RATE, height=0.3, width=0.015, every=0.4, seed=3)
    noise = 0.004 * np.random.default_rng(2).standard_normal(reference.size)
    loop = ClosedLoop(joint_of(model, None, friction), LAW)
    return simulated_record(loop, reference, values, sample_time=RATE, injected=known, torque_noise=noise)


def on_side(record: Record, gear: Transmission) -> Record:
    """Return a record of the motor's side as the joint's side has it, by hand."""
    r = gear.motor_per_load if gear.side == "load" else 1.0
    position, torque = {"prismatic": ("m", "N"), "revolute": ("rad", "N m")}[gear.kind]

    def of(channel: Channel | None, by: float, unit: str) -> Channel | None:
        return channel and replace(channel, values=channel.values * by, unit=unit)

    known = record.injected and of(record.injected.channel, r, torque)
    return replace(
        record,
        torque=of(record.torque, r, torque),
        injected=record.injected and replace(record.injected, channel=known),  # type: ignore[arg-type]
        **{n: of(getattr(record, n), 1 / r, position) for n in ("reference", "motor_position", "load_position")},  # type: ignore[arg-type]
    )


def found(model: str, gear: Transmission | None, friction: str = "symmetric") -> Estimate:
    record = logged(model, friction)
    if gear is None:
        return identify(record, ClosedLoop(joint_of(model, None, friction), LAW))
    law = replace(LAW, ratio=gear.torque("motor"))
    return identify(on_side(record, gear), ClosedLoop(joint_of(model, gear, friction), law))


def apart(one: Mapping[str, float | None], other: Mapping[str, float | None]) -> float:
    """Return the largest relative difference of values by name; what is None or 0 must be so in both."""
    assert one.keys() == other.keys()
    assert all(bool(other[name]) == bool(value) for name, value in one.items())
    return max(abs((other[name] or 0.0) / value - 1) for name, value in one.items() if value)


def values_of(parameters: Sequence[EstimatedParameter], what: str = "value") -> dict[str, float | None]:
    return {p.name: getattr(p, what) for p in parameters}


def beyond(estimate: Estimate) -> tuple[EstimatedParameter, ...]:
    """Return the parameters on the other side of the transmission."""
    gear = estimate.settings.joint.transmission
    assert gear is not None
    return on_other_side(estimate.rows, gear, estimate.data.torque_unit)


by_motor = cache(found)
GEARS = {"turned round": TURNED, "screw": SCREW, "on the motor": replace(TURNED, side="motor")}
CASES = [("rigid", "symmetric"), ("rigid", "asymmetric"), ("flexible", "symmetric")]


@pytest.mark.parametrize("gear", GEARS.values(), ids=GEARS)
@pytest.mark.parametrize(("model", "friction"), CASES)
def test_either_side_of_a_gear_gives_the_same_answer(gear: Transmission, model: str, friction: str) -> None:
    """Values and deviations, to rounding, some 1e-11, in as many simulations."""
    motor, there = by_motor(model, None, friction), found(model, gear, friction)
    back = there.rows if gear.side == "motor" else beyond(there)
    assert [p.unit for p in back] == [p.unit for p in motor.rows]
    assert apart(values_of(motor.rows), values_of(back)) < CLOSE
    assert apart(values_of(motor.rows, "stderr"), values_of(back, "stderr")) < CLOSE
    assert there.fit.simulations == motor.fit.simulations
    assert there.fit.filtered_error == pytest.approx(motor.fit.filtered_error, rel=1e-9)
    truth, name = (FLEXIBLE, "stiffness") if model == "flexible" else (RIGID, "inertia")
    assert values_of(back)[name] == pytest.approx(truth[name], rel=0.02)


@pytest.mark.parametrize("gear", [TURNED, SCREW], ids=["turned round", "screw"])
def test_inverse_models_have_both_sides_too(gear: Transmission) -> None:
    """Ripple as well: a force that is even in the position is turned round, one that is odd is not."""
    period = 2 * math.pi
    record = logged("rigid")
    motor = identify(record, replace(joint_of("rigid", None), ripple=PositionHarmonics(period, 2)), IDIM())
    ripple = PositionHarmonics(period / abs(gear.motor_per_load), 2)
    there = identify(on_side(record, gear), replace(joint_of("rigid", gear), ripple=ripple), IDIM())
    assert apart(values_of(motor.rows), values_of(beyond(there))) < 1e-7  # a parabola of small amplitudes
    assert [p.unit for p in beyond(there)] == [p.unit for p in motor.rows]


def test_a_gain_that_is_freed_is_that_of_the_law_on_its_own_side() -> None:
    """Kv is 5 % more than declared: freed, it is found in the unit it is declared in, on either side."""
    wrong, settings = replace(LAW, velocity_gain=LAW.velocity_gain / 1.05), DIDIM(free=("velocity_gain",))
    gear = replace(TURNED, side="load")
    motor = identify(logged("rigid"), ClosedLoop(joint_of("rigid", None), wrong), settings)
    seen = replace(wrong, ratio=gear.torque("motor"))
    there = identify(on_side(logged("rigid"), gear), ClosedLoop(joint_of("rigid", gear), seen), settings)
    assert motor["velocity_gain"].value == pytest.approx(LAW.velocity_gain, rel=0.01)
    assert there["velocity_gain"].value == pytest.approx(motor["velocity_gain"].value, rel=1e-8)
    assert there["velocity_gain"].stderr == pytest.approx(motor["velocity_gain"].stderr, rel=1e-6)
    (beside,) = (p for p in beyond(there) if p.name == "velocity_gain")
    assert (beside.value, beside.unit) == (there["velocity_gain"].value, "as declared")
