"""The regression that a law is looked for with: the same torque as the law itself, under the noise that there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jointid.common.arrays import FloatArray
from jointid.controller_id.columns import coefficient_columns, columns
from jointid.controller_id.fitting import Task
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.noise import position_error, position_response
from jointid.controller_id.ranking import start_law
from jointid.controller_id.regression import RegressionFit, initial_weighting, law_numbers, regression
from jointid.controller_id.structure_moves import canonical, list_laws, list_neighbours, list_simpler
from jointid.controller_id.structures import INTERPOLATIONS, LATE, RATES, SLOWER, Structure
from jointid.models.controllers import INPUTS, PD, POSITION, Cascade, FirstOrder, SecondOrder, run
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Timing
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.learned import loop_twin

T = 1e-3


@pytest.mark.parametrize("seed", [300, 304, 305, 319, 323, 333, 339, 342, 352, 361])
def test_a_law_s_own_regression_predicts_what_the_law_does(seed: int) -> None:
    """Filters, clocks, delays, feed-forwards: two writings of one equation, on noisy twins of all laws."""
    twin = loop_twin(seed)
    task, structure = Task(prepare_loop_record(twin.record), 1.0), twin.structure
    on = regression(task.log)
    nonlinear = (
        "velocity_filter",
        "torque_filters",
        "reference_delay",
        *(("integral_gain",) if structure.cascade else ()),
    )
    numbers = {name: value for name, value in twin.numbers.items() if name.startswith(nonlinear)}
    weighting = initial_weighting(on)
    for _ in range(2):
        found = on.fit_gains(structure, numbers, weighting, free=False)[0]
        weighting = on.weighting(found)
    gains = law_numbers(found, 1.0)
    for name in ("position_gain", "velocity_gain", "derivative_gain"):
        assert gains.get(name, 1.0) == pytest.approx(twin.numbers.get(name, 1.0), rel=2e-2), name
    residual = np.concatenate([task.residual(structure, gains)[structure.late :], np.zeros(structure.late)])
    difference = residual * on.kept - found.residual
    assert np.std(difference) < 1e-8 * np.std(task.log.torque)


@pytest.mark.parametrize("seed", [319, 340])
def test_an_integral_s_content_is_that_at_the_first_sample_of_a_stretch(seed: int) -> None:
    """A stretch begins in motion, with something in the integral."""
    twin = loop_twin(seed)
    task = Task(prepare_loop_record(twin.record), 1.0).select_strongest(4000)
    on = regression(task.log)
    names = ("velocity_filter", "reference_delay")
    numbers = {name: value for name, value in twin.numbers.items() if name.startswith(names)}
    found = on.fit_gains(twin.structure, numbers, initial_weighting(on), free=False)[0]
    residual = task.residual(twin.structure, law_numbers(found, 1.0))
    assert np.std(residual * on.kept - found.residual) < 1e-8 * np.std(task.log.torque)


def test_a_negative_velocity_gain_stays_one() -> None:
    """Else a law without damping would pass, at the cost of one that cannot be."""
    structure, size = Structure("P-P", "share"), 3
    position_gain, velocity_gain, fed = coefficient_columns(structure, 0.0).values()
    nothing = np.zeros(size)
    gains = law_numbers(
        RegressionFit(structure, {}, 0.0, 3e4 * position_gain - 500.0 * velocity_gain + 400.0 * fed, nothing, nothing),
        1.0,
    )
    assert gains == pytest.approx({"position_gain": 60.0, "velocity_gain": -500.0, "velocity_feedforward": 0.8})


def test_a_step_of_gauss_and_newton_foretells_what_a_search_will_leave() -> None:
    twin = loop_twin(342)
    on = replace(regression(prepare_loop_record(twin.record)), own=True)
    far = {name: 1.1 * value for name, value in twin.numbers.items() if "filter" in name}
    near = {name: value for name, value in twin.numbers.items() if "filter" in name}
    weighting = on.weighting(on.fit_gains(twin.structure, near, initial_weighting(on), free=False)[0])
    begun = start_law(on, twin.structure, [far], weighting)
    here = on.fit_gains(twin.structure, far, weighting, free=False)[0]
    there = on.refine(here, weighting, free=False)
    assert begun is not None
    assert here.cost > 5 * there.cost
    assert abs(begun.cost - there.cost) < 0.1 * there.cost


def test_an_encoder_s_rounding_is_made_again() -> None:
    """At an even speed it is a line: 38.2 steps per sample leave a fifth of the log's rate."""
    at = np.arange(4000)
    position = 38.2 * at + 300.0 * np.sin(2e-3 * at)
    logged = np.round(position)
    error = position_error(logged, 1.0)
    frequencies = np.linspace(0.0, 0.5, error.shape.size)
    assert 0.18 < frequencies[np.argmax(error.shape)] < 0.22
    seen = np.abs(np.fft.rfft(logged - position)) ** 2
    bands = np.array_split(np.arange(1, seen.size), 40)
    made, real = (np.log([np.mean(one[band]) for band in bands]) for one in (error.shape**2, seen))
    assert np.corrcoef(made, real)[0, 1] > 0.7
    assert np.var(logged - position) < error.most < 2 * np.var(logged - position)


def test_a_clock_is_charged_for_how_many_there_are() -> None:
    """Else the best of many chances wins; a part of which there is one is charged log(rows) alone."""
    plain, rows = Structure(), 1000.0
    part = plain.weight(rows) / plain.parts
    assert part == pytest.approx(np.log(rows))
    assert Structure(feedforward=frozenset({"acceleration"})).weight(rows) == pytest.approx((plain.parts + 1) * part)
    choices = {"rate": (2, len(INTERPOLATIONS) * len(RATES)), "every": (2, sum(SLOWER)), "late": (1, len(LATE))}
    for name, (value, count) in choices.items():
        clocked = replace(plain, **{name: value})
        assert clocked.weight(rows) == pytest.approx(clocked.parts * part + 2.0 * np.log(count)), name


def test_lines_between_samples_have_no_acceleration_but_rounding() -> None:
    """A column of rounding would be as good as any to a regression, with a gain beyond all numbers."""
    twin = loop_twin(300)
    fast = Structure(feedforward=frozenset({"acceleration"}), rate=8)
    found = columns(prepare_loop_record(twin.record), fast, {})
    assert not np.any(found[:, np.argmax(coefficient_columns(fast, 0.0)["acceleration_feedforward"])])


def test_what_a_law_faster_than_the_log_sees_of_the_log_s_error() -> None:
    """An error of one sample, through the spline and the law, and back to the log's samples."""
    size, rate = 1000, 4
    law = PD(position_gain=3.0, derivative_gain=0.02, velocity_filter=FirstOrder(8e-4), period=T / rate).law(T)
    error = np.zeros(size)
    error[size // 2] = 1.0
    inputs = np.zeros((size * rate, INPUTS))
    at = np.minimum(np.arange(size * rate) / rate, size - 1.0)
    inputs[:, POSITION] = CubicSpline(np.arange(size), error)(at)
    seen = run(law, inputs, np.zeros(law.order)).output[::rate]
    expected: FloatArray = np.abs(np.fft.rfft(seen))
    found = position_response(law.feedback, T, size, rate)
    assert np.allclose(found[5:], expected[5:], rtol=0.02, atol=0.01 * expected.max())


def test_every_law_is_there_under_one_name_and_every_part_can_go() -> None:
    frame = Structure(velocity_filter="first order")
    laws = list(list_laws(frame, channel=False))
    assert len(laws) == len(set(laws)) == len({str(one) for one in laws})
    assert {one.law for one in laws} == {"P-P", "P-PI", "PD", "PID"}
    for law in laws:
        assert canonical(law) == law
        assert all(one.parts < law.parts or one.law != law.law for one in list_simpler(law))
    plain = Structure("P-P", "full", torque_filter="first order")  # also a PD with its filter on the difference
    assert Structure("PD", "difference", "first order") in set(list_neighbours(plain, channel=False))


@pytest.mark.parametrize("seed", [304, 319, 323, 361])
def test_a_regression_reacts_to_the_position_as_the_law_does(seed: int) -> None:
    """|G| by both writings, where the law is heard: all the weighing depends on it."""
    twin = loop_twin(seed)
    task, structure = Task(prepare_loop_record(twin.record), 1.0), twin.structure
    on = regression(task.log)
    nonlinear = (
        "velocity_filter",
        "torque_filters",
        "reference_delay",
        *(("integral_gain",) if structure.cascade else ()),
    )
    numbers = {name: value for name, value in twin.numbers.items() if name.startswith(nonlinear)}
    found = on.fit_gains(structure, numbers, initial_weighting(on), free=False)[0]
    law, samples = task.law(structure, law_numbers(found, 1.0)), task.log.samples
    expected = position_response(law.feedback, T, samples, structure.rate) * task.log.error.shape
    assert np.allclose(found.response, expected, rtol=1e-6, atol=1e-3 * expected.max())


def test_near_half_the_rate_a_response_ends_in_its_zero() -> None:
    """Second order by the bilinear rule: (pi - w)^2 there, which a line between two far points would make too large."""
    law = PD(position_gain=0.0, derivative_gain=1.0, velocity_filter=SecondOrder(200.0)).law(T)
    found, hertz = position_response(law.feedback, T, 4000, 1), np.fft.rfftfreq(4000, T)
    high = (hertz > 430.0) & (hertz < 495.0)
    assert np.allclose(found[high], np.abs(law.feedback(hertz[high])), rtol=0.1, atol=0.1)


def test_a_stretch_keeps_the_phase_of_a_slower_loop() -> None:
    twin = next(twin for twin in map(loop_twin, range(300, 400)) if twin.structure.every > 2)
    whole = prepare_loop_record(twin.record)
    numbers = {name: value for name, value in twin.numbers.items() if name == "integral_gain" or "filter" in name}
    for samples in (3000, 3001, 4003, 4502):
        on = regression(whole.select_strongest(samples))
        left = [
            np.std(
                on.fit_gains(replace(twin.structure, offset=k), numbers, initial_weighting(on), free=False)[0].residual
            )
            for k in range(twin.structure.every)
        ]
        assert int(np.argmin(left)) == twin.structure.offset, samples


@pytest.mark.parametrize("at", ["before_limit", "after_limit"])
@pytest.mark.parametrize("averaged", [False, True], ids=["held", "averaged"])
def test_what_is_injected_is_no_part_of_the_law(at: str, averaged: bool) -> None:
    """The known signal is in the torque of law and log, filtered with it where it is injected before the limit."""
    reference = trapezoids([0.1, 0.3], 2.0, 0.2, T, 0.1, 4.0)
    known = pulses(reference.size, T, height=20.0, width=0.02, every=0.2, seed=1)
    law = Cascade(position_gain=60.0, velocity_gain=500.0, torque_filters=(FirstOrder(2e-3),))
    values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}
    record = simulated_record(
        ClosedLoop(RigidJoint("prismatic"), law),
        reference,
        values,
        sample_time=T,
        injected=known,
        at=at,
        encoder_step=1e-9,
    )
    assert record.torque is not None
    if averaged:
        means = np.concatenate([record.torque.values[:1], record.torque.values[:-1]])
        record = replace(record, torque=replace(record.torque, values=means, timing=Timing.AVERAGED))
    structure = Structure(torque_filter="first order")
    task = Task(prepare_loop_record(record), 1.0)
    on = regression(task.log)
    numbers = {"position_gain": 60.0, "velocity_gain": 500.0, "torque_filters.0.time_constant": 2e-3}
    size = np.std(task.log.torque)
    assert np.std(task.residual(structure, numbers)) < 1e-3 * size
    filters = {"torque_filters.0.time_constant": 2e-3}
    assert np.std(on.fit_gains(structure, filters, initial_weighting(on), free=False)[0].residual) < 1e-3 * size
