"""Intervals that are predicted: beside those of estimates that are made, and as they must scale."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import jointid as ji
from jointid.planning.predict import Noise
from jointid.simulation import excitation
from tests.planning.planned import LOOP, TRUTH, T, planned_record, predict_test

REFERENCE = excitation.trapezoids((0.5, 1.0, 2.0), 8.0, 2.0, T, duration=6.0)


@pytest.mark.slow
def test_intervals_scale_as_they_must() -> None:
    test = planned_record(LOOP, REFERENCE, T)
    once = predict_test(LOOP, TRUTH, test, Noise(log=0.01)).covariance.std
    assert predict_test(LOOP, TRUTH, test, Noise(log=0.02)).covariance.std == pytest.approx(2 * once, rel=1e-9)
    cycle = excitation.trapezoids((0.5, 1.0, 2.0), 8.0, 2.0, T, rest=0.2)
    short, long = (planned_record(LOOP, np.tile(cycle, times), T) for times in (1, 4))
    before, after = (predict_test(LOOP, TRUTH, one, Noise(log=0.01)).covariance.std for one in (short, long))
    assert after == pytest.approx(0.5 * before, rel=0.15)
    roughly = predict_test(LOOP, TRUTH, test, Noise(log=0.01), runs=1)
    assert roughly.covariance.std == pytest.approx(once, rel=0.35)  # from one run
    assert [roughly.reached[0][name] for name in ("stroke", "acceleration")] == pytest.approx([2.0, 8.0], rel=0.02)


def test_the_noise_of_a_first_record_gives_its_own_intervals_back() -> None:
    axis = ji.twin("L19", noise="disturbance")
    record = axis.record.without("motor_position", "load_position")
    estimate = ji.identify(record, axis.loop, ji.DIDIM(frequency=30.0), checks=False)
    noise = Noise.of(estimate, record)
    told = predict_test(axis.loop, estimate.values, record, noise, filtering=estimate.settings.filtering)
    for name in told.joint:
        assert told.std[name] == pytest.approx(estimate[name].stderr, rel=0.02), name
    twice = predict_test(axis.loop, estimate.values, record, replace(noise, left=2 * noise.left))
    assert twice.std["stiffness"] == pytest.approx(2 * told.std["stiffness"], rel=0.02)


def test_what_a_test_does_not_tell_has_no_bound() -> None:
    still, one_way = (planned_record(LOOP, reference, T) for reference in (np.zeros(3000), np.arange(3000) * 2e-4))
    assert np.all(np.isinf(list(predict_test(LOOP, TRUTH, still, Noise(log=0.01)).std.values())[:3]))
    told = predict_test(LOOP, TRUTH, one_way, Noise(log=0.01))
    assert np.isinf([told.std["coulomb"], told.std["offset"]]).all()
    assert told.std_of({"offset": 1.0}) == np.inf


def test_the_pulsed_record_of_a_real_axis_is_predicted_from_the_other(data_dir: Path) -> None:
    """EMPS: from DATA_EMPS alone, what its other record gives an hour later; half of what is left repeats."""
    file = ji.load(Path(__file__).parents[2] / "examples" / "emps" / "joint.toml")
    first, second = (file.record(data_dir / "emps" / name) for name in ("DATA_EMPS.mat", "DATA_EMPS_PULSES.mat"))
    assert file.loop is not None
    known, given = (
        ji.identify(record, file.loop, file.method, filtering=file.filtering, checks=False)
        for record in (first, second)
    )
    told = predict_test(file.loop, known.values, second, Noise.of(known, first), filtering=file.filtering)
    for name in told.joint:
        assert told.std[name] == pytest.approx(given[name].stderr, rel=0.1), name
    assert told.std["inertia"] < 0.85 * known["inertia"].stderr
