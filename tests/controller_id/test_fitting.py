"""The columns that a law is fitted with: the same torque as the law itself, under the noise that there is."""

import tracemalloc
from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import jointid as ji
from jointid.controller_id.fitting import Fitter, order_rates
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.noise import band_means, band_power, band_widths, position_error, position_response
from jointid.controller_id.structures import Structure, canonical, controller, list_frames, list_laws
from jointid.models.controllers import PD, POSITION, Cascade, FirstOrder, run
from jointid.models.controllers.sampled import INPUTS
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.records.record import Timing
from jointid.simulation.excitation import trapezoids
from jointid.simulation.synthesis import simulated_record
from studies.learned import loop_twin
from tests.learned_once import run_law

T = 1e-3


@pytest.mark.parametrize("seed", [300, 304, 305, 308, 319, 323, 333, 339, 342, 352, 361])
def test_columns_make_the_torque_of_the_law_itself(seed: int) -> None:
    twin = loop_twin(seed)
    fitter, size = Fitter(prepare_loop_record(twin.record)), np.std(twin.record.torque.values)
    law = fitter.law(twin.structure, twin.numbers)
    exact = run_law(fitter.log, twin.structure, twin.numbers)
    assert np.std((exact - fitter.predict(law)) * fitter.log.kept) < 1e-8 * size
    left = np.fft.irfft(law.residual, fitter.log.samples) * np.sqrt(np.sum(fitter.kept))
    late = twin.structure.late
    own = np.concatenate([(fitter.log.torque - exact)[late:], np.zeros(late)]) * fitter.kept
    assert np.std(left - own) < 1e-8 * size
    expected = position_response(
        controller(twin.structure, twin.numbers, T, 1.0).law(T).feedback, T, fitter.log.samples, twin.structure.rate
    )
    if twin.structure.every == 1:
        expected = expected * fitter.log.error.shape
        assert np.allclose(law.response, expected, rtol=1e-6, atol=1e-3 * expected.max())


@pytest.mark.parametrize("seed", [304, 319, 333, 340])
def test_gains_are_solved_for(seed: int) -> None:
    twin = loop_twin(seed)
    fitter = Fitter(prepare_loop_record(twin.record).select_strongest(4000))
    near = {name: value for name, value in twin.numbers.items() if name != "integral"}
    begun = fitter.fit(twin.structure, near, fitter.shared, 0)
    fitter.share(begun)
    found = fitter.fit(twin.structure, near, begun.noise, 0)
    for name in ("position_gain", "velocity_gain", "derivative_gain"):
        assert found.numbers.get(name, 1.0) == pytest.approx(twin.numbers.get(name, 1.0), rel=2e-2), name
    exact = run_law(fitter.log, twin.structure, found.numbers)
    assert np.std((exact - fitter.predict(found)) * fitter.kept) < 1e-8 * np.std(fitter.log.torque)


def test_of_two_rates_that_may_be_exchanged_the_larger_is_the_position_loop_s() -> None:
    twin = loop_twin(117)
    assert (twin.structure.law, twin.structure.reference_velocity) == ("P-PI", "full")
    fitter = Fitter(prepare_loop_record(twin.record))
    right = fitter.law(twin.structure, twin.numbers)
    kp, kv, ki = (twin.numbers[name] for name in ("position_gain", "velocity_gain", "integral_gain"))
    other = kp / (1 + kp * T)
    gain = kv * (1 - ki * T) / (1 - other * T)
    near = {"position_gain": kv * kp * ki / (gain * other), "velocity_gain": gain, "integral_gain": other}
    exchanged = fitter.law(twin.structure, twin.numbers | near)
    assert np.linalg.norm(exchanged.residual - right.residual) < 1e-7 * np.linalg.norm(right.residual)
    assert exchanged.numbers["position_gain"] < exchanged.numbers["integral_gain"]
    assert order_rates(exchanged, T) == pytest.approx(right.numbers)
    assert order_rates(right, T) == right.numbers


def test_an_encoder_s_rounding_is_made_again() -> None:
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


def test_what_a_law_faster_than_the_log_sees_of_the_log_s_error() -> None:
    size, rate = 1000, 4
    law = PD(position_gain=3.0, derivative_gain=0.02, velocity_filter=FirstOrder(8e-4), period=T / rate).law(T)
    error = np.zeros(size)
    error[size // 2] = 1.0
    inputs = np.zeros((size * rate, INPUTS))
    at = np.minimum(np.arange(size * rate) / rate, size - 1.0)
    inputs[:, POSITION] = CubicSpline(np.arange(size), error)(at)
    seen = run(law, inputs, np.zeros(law.order))[::rate]
    expected: np.ndarray = np.abs(np.fft.rfft(seen))
    found = position_response(law.feedback, T, size, rate)
    assert np.allclose(found[5:], expected[5:], rtol=0.02, atol=0.01 * expected.max())


def test_every_law_has_one_name_and_every_part_can_go() -> None:
    assert canonical(Structure("PD", "difference")) == Structure("P-P", "full")
    assert canonical(Structure("PID", "difference")) == Structure("P-PI", "full")
    filtered = Structure("PID", "difference", "first order", frozenset({"acceleration"}), "notch", True)
    assert canonical(filtered) == filtered
    near = [*list_laws(filtered, channel=False), *list_frames(filtered)]
    assert len(near) == len({str(one) for one in near})
    assert {one.law for one in near} == {"P-P", "P-PI", "PD", "PID"}
    assert all(canonical(one) == one != filtered for one in near)
    for less in ({"law": "PD"}, {"feedforward": frozenset()}, {"torque_filter": "none"}, {"reference_delay": False}):
        assert replace(filtered, **less) in near
    plain = Structure("P-P", "full", torque_filter="first order")  # also a PD with its filter on the difference
    assert Structure("PD", "difference", "first order") in list_frames(plain)


def test_a_stretch_keeps_the_phase_of_a_slower_loop() -> None:
    twin = next(twin for twin in map(loop_twin, range(300, 400)) if twin.structure.every > 2)
    whole = prepare_loop_record(twin.record)
    numbers = {name: value for name, value in twin.numbers.items() if name == "integral_gain" or "filter" in name}
    for samples in (3000, 3001, 4003, 4502):
        fitter = Fitter(whole.select_strongest(samples))
        left = [
            np.linalg.norm(fitter.solve(replace(twin.structure, offset=k), numbers).residual)
            for k in range(twin.structure.every)
        ]
        assert int(np.argmin(left)) == twin.structure.offset, samples


@pytest.mark.parametrize("at", ["before_limit", "after_limit"])
@pytest.mark.parametrize("averaged", [False, True], ids=["held", "averaged"])
def test_what_is_injected_is_no_part_of_the_law(at: str, averaged: bool) -> None:
    reference = ji.excitation.trapezoids([0.1, 0.3], 2.0, 0.2, T, 0.1, 4.0)
    known = ji.excitation.pulses(reference.size, T, height=20.0, width=0.02, every=0.2, seed=1)
    law = Cascade(position_gain=60.0, velocity_gain=500.0, torque_filters=(FirstOrder(2e-3),))
    values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}
    record = ji.simulated_record(
        ji.ClosedLoop(ji.RigidJoint("prismatic"), law),
        reference,
        values,
        sample_time=T,
        injected=known,
        at=at,
        encoder_step=1e-9,
    )
    if averaged:
        means = np.concatenate([record.torque.values[:1], record.torque.values[:-1]])
        record = replace(record, torque=replace(record.torque, values=means, timing=Timing.AVERAGED))
    structure = Structure(torque_filter="first order")
    fitter = Fitter(prepare_loop_record(record))
    numbers = {"position_gain": 60.0, "velocity_gain": 500.0, "torque_filters.0.time_constant": 2e-3}
    size = np.std(fitter.log.torque)
    for shown in (run_law(fitter.log, structure, numbers), fitter.predict(fitter.law(structure, numbers))):
        assert np.std((fitter.log.torque - shown) * fitter.log.kept) < 1e-3 * size


SEEDS = (57, 134, 140, 160, 180, 500, 506, 512)


@pytest.mark.parametrize("seed", SEEDS)
def test_without_a_law_as_much_is_heard_as_with_the_true_one(seed: int) -> None:
    twin = loop_twin(seed)
    log = prepare_loop_record(twin.record)
    louder = band_power(log.torque) / band_power((log.torque - run_law(log, twin.structure, twin.numbers)) * log.kept)
    informative, wide, error = band_means(log.informative), band_widths(log.informative.size), log.error
    clear = (louder > 8.0) & (error.power > 8.0 * error.variance * band_means(error.shape**2))
    assert wide[clear] @ informative[clear] > 0.9 * np.sum(wide[clear])


def test_noise_is_not_heard() -> None:
    twin = loop_twin(134)
    torque = twin.record.torque
    size = 0.05 * np.std(torque.values)
    noise = size * np.random.default_rng(1).standard_normal(torque.values.size)
    noisy = replace(torque, values=torque.values + noise)
    informative = band_means(prepare_loop_record(replace(twin.record, torque=noisy)).informative)
    law = prepare_loop_record(twin.record).torque  # less what was added
    louder = band_power(law - law.mean()) / size**2
    assert np.mean(louder > 10.0) > 0.05 and np.mean(louder < 1.0) > 0.5
    assert np.mean(informative[louder > 10.0]) > 0.9
    assert np.mean(informative[louder < 1.0]) < 0.02


def test_a_long_record_needs_no_memory_for_all_columns_at_once() -> None:
    law, peaks = Cascade(position_gain=60.0, velocity_gain=500.0), []
    values = {"inertia": 5.0, "viscous": 20.0, "coulomb": 10.0, "offset": 1.0}
    for duration in (20.0, 60.0):
        reference = trapezoids([0.1, 0.3, 0.5], 2.0, 0.2, 1e-3, 0.1, duration)
        record = simulated_record(ClosedLoop(RigidJoint("prismatic"), law), reference, values, sample_time=1e-3)
        tracemalloc.start()
        samples = prepare_loop_record(record).samples
        peaks.append((samples, tracemalloc.get_traced_memory()[1]))
        tracemalloc.stop()
    (few, low), (many, high) = peaks
    assert (high - low) / (many - few) < 1000  # bytes
