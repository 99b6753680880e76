"""The frequency response and the spectra that a report shows."""

from __future__ import annotations

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.report_data import compute_response, estimate_spectra
from jointid.models.linear import frequency_response
from tests.output.report import reports

VALUES = {
    "motor_inertia": 70.2, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 8e5, "damping": 126.0,
    "load_inertia": 34.8, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": 0.0,
}  # fmt: skip


def test_the_response_is_that_of_the_equations_of_motion() -> None:
    v = VALUES
    for hertz in (0.3, 24.0, 30.0, 200.0):
        s = 2j * np.pi * hertz
        spring = v["damping"] * s + v["stiffness"]
        matrix = np.array(
            [
                [v["motor_inertia"] * s**2 + v["motor_viscous"] * s + spring, -spring],
                [-spring, v["load_inertia"] * s**2 + v["load_viscous"] * s + spring],
            ]
        )
        expected = s * np.linalg.solve(matrix, [1.0, 0.0])
        found = [
            frequency_response(ji.FlexibleJoint("prismatic"), v, np.array([hertz]), output)[0]
            for output in ("motor_velocity", "load_velocity")
        ]
        assert found == pytest.approx(list(expected), rel=1e-9)


def test_the_motor_dips_at_the_motor_locked_frequency_and_peaks_at_the_free_free_one() -> None:
    found = compute_response(reports.flexible().estimate)
    motor = found.curves[0]
    near = (found.frequency > 15) & (found.frequency < 60)
    lowest = found.frequency[near][np.argmin(motor.magnitude[near])]
    highest = found.frequency[near][np.argmax(motor.magnitude[near])]
    assert lowest == pytest.approx(found.modes["motor_locked"], rel=0.02)
    assert highest == pytest.approx(found.modes["free_free"], rel=0.02)


def test_the_band_is_that_of_the_covariance() -> None:
    estimate = reports.rigid().estimate
    found = compute_response(estimate)
    curve = found.curves[0]
    inertia = estimate["inertia"]
    assert inertia.value is not None
    assert inertia.stderr is not None
    ratio = curve.high[-1] / curve.magnitude[-1]  # far above the corner only the inertia counts
    assert np.log(ratio) == pytest.approx(2 * inertia.stderr / inertia.value, rel=0.02)


def test_the_spectrum_of_white_noise_is_flat_and_of_the_right_size() -> None:
    noise = np.random.default_rng(0).standard_normal(50_000)
    found = estimate_spectra(noise, np.zeros_like(noise), 1e-3)
    inner = found.error[2:-2]
    assert np.mean(inner**2) == pytest.approx(1.0 / 500.0, rel=0.03)  # variance 1 over 500 Hz
    assert np.array_equal(found.error, found.measured)
    with pytest.raises(ji.RecordError):
        estimate_spectra(noise[:20], noise[:20], 1e-3)
