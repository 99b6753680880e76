"""The solver gets there: from nothing, from wrong starts, on plants of any size, and in few simulations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from jointid.common.parameters import Parameter
from jointid.estimation.identify import identify
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.problems.closed_loop import torque_problem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Cascade
from jointid.models.joints import FlexibleJoint
from jointid.paper.twin import twin
from jointid.records.record import Channel, Record
from jointid.simulation.closed_loop import in_threads
from tests.plants import Case, prismatic, rotary

NOISE = 0.04


@dataclass(frozen=True)
class Outcome:
    """How one plant went: cost over that of the truth, and the search's own simulations."""

    seed: int
    ratio: float
    simulations: int
    error: str = ""


def search_of(estimate: Estimate) -> int:
    """The simulations of the search, up to its last step; the verdicts on its answer take some more."""
    return estimate.fit.trace[-1].simulations if estimate.fit.trace else estimate.fit.simulations


def cost(case: Case, record: Record, estimate: Estimate) -> float:
    """The criterion at the end over the criterion at the truth, on the band of the estimate."""
    problem = torque_problem(record, case.loop, estimate.settings.filtering, case.loop.joint.parameters)
    found = {p.name: p.value for p in estimate.params}
    if None in found.values():
        return np.inf
    assert record.reference is not None
    truth = case.truth | {"initial_position": float(record.reference.values[0]), "initial_velocity": 0.0}
    ends = [float(np.sum(problem.residual(problem.vector(v)) ** 2)) for v in (found, truth)]  # type: ignore[arg-type]
    return ends[0] / ends[1]


def outcome(make: Callable[[int], Case], seed: int, spread: float = 0.0) -> Outcome:
    case = make(seed)
    record = case.noisy(NOISE, seed)
    starts: dict[str, Parameter] = {}
    if spread:
        rng = np.random.default_rng([seed, 3])
        starts = {
            p.name: replace(p, start=case.truth[p.name] * spread ** rng.uniform(-1, 1))
            for p in case.loop.joint.parameters
            if p.name != "offset"
        }
    try:
        estimate = identify(record, case.loop, parameters=starts)
    except Exception as error:
        return Outcome(seed, np.inf, 0, repr(error))
    return Outcome(seed, cost(case, record, estimate), search_of(estimate))


@pytest.mark.parametrize("make", [prismatic, rotary])
def test_a_plant_is_identified_from_nothing(make: Callable[[int], Case]) -> None:
    """One of each family; below there are sixty."""
    found = outcome(make, 2)
    assert not found.error
    assert found.ratio <= 1.01
    assert found.simulations <= 250


@pytest.mark.statistical
@pytest.mark.parametrize("make", [prismatic, rotary])
def test_random_plants_are_identified_from_nothing(make: Callable[[int], Case]) -> None:
    """Of 60 of each family 98 % end at the noise floor, whatever their size; a refused stiffness counts as lost."""
    found = in_threads(lambda seed: outcome(make, seed), range(60))
    lost = [one for one in found if not one.ratio <= 1.01]
    effort = [one.simulations for one in found if one.simulations]
    assert len(lost) <= 1, lost
    assert not any(one.error for one in found), [one for one in found if one.error]
    assert np.median(effort) <= 150
    assert np.percentile(effort, 95) <= 250


@pytest.mark.statistical
@pytest.mark.parametrize("make", [prismatic, rotary])
def test_starts_within_a_factor_of_ten_lead_there_too(make: Callable[[int], Case]) -> None:
    found = in_threads(lambda seed: outcome(make, seed, spread=10.0), range(24))
    lost = [one for one in found if not one.ratio <= 1.01]
    assert len(lost) <= 1, lost


@pytest.mark.slow
@pytest.mark.parametrize("seed", [67, 69])
def test_a_poor_rigid_start_is_not_the_end_of_it(seed: int) -> None:
    """Of 67 every spring on the rigid joint is unstable; the mode of 69 lies beside the cut-off of its rigid start."""
    found = outcome(rotary, seed)
    assert not found.error
    assert found.ratio <= 1.01


@pytest.mark.parametrize("loop", ["L19", "L30"])
@pytest.mark.parametrize("frequency", [15.0, 60.0])  # 30 Hz and no frequency are in test_flexible
def test_any_start_from_15_to_60_hz_ends_at_the_truth(
    loop: str, frequency: float, identified: Callable[..., Estimate]
) -> None:
    axis = twin(loop, noise="none")  # type: ignore[arg-type]
    estimate = identified(loop, FlexibleDIDIM(frequency=frequency), noise="none")
    for name, value in axis.truth.items():
        assert estimate.values[name] == pytest.approx(value, rel=1e-4), name
    assert estimate.fit.simulations <= 700


def test_units_of_mass_length_and_time_do_not_matter() -> None:
    """The same drive in units of 1/1024 kg and 1/64 s: the same answer, after the same simulations."""
    case = rotary(5)
    record = case.noisy(NOISE, 5)
    plain = identify(record, case.loop)
    time = 64.0
    torque = 1024.0 / time**2
    controller = case.loop.controller
    assert isinstance(controller, Cascade)
    assert record.torque is not None
    assert record.reference is not None
    assert record.injected is not None

    def scaled(channel: Channel, by: float) -> Channel:
        return replace(channel, values=channel.values * by, sample_time=channel.sample_time * time)

    other = replace(
        record,
        torque=scaled(record.torque, torque),
        reference=scaled(record.reference, 1.0),
        injected=replace(record.injected, channel=scaled(record.injected.channel, torque)),
    )
    slow = replace(
        controller,
        position_gain=controller.position_gain / time,
        velocity_gain=controller.velocity_gain * torque * time,
    )
    moved = identify(other, replace(case.loop, controller=slow))
    assert moved.fit.simulations == plain.fit.simulations
    units = {"inertia": torque * time**2, "viscous": torque * time, "coulomb": torque, "damping": torque * time}
    for name, value in plain.values.items():
        factor = units.get(name.split("_")[-1], torque)
        assert moved.values[name] / factor == pytest.approx(value, rel=1e-9), name
    ratio = FlexibleJoint.frequencies(moved.values)["free_free"] / FlexibleJoint.frequencies(plain.values)["free_free"]
    assert ratio == pytest.approx(1 / time, rel=1e-9)
