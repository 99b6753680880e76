"""The regression that a law is looked for with: the same torque as the law itself, under the noise that there is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from jointid.data.record import FloatArray
from jointid.learning.changes import all_laws, canonical, neighbours, simpler
from jointid.learning.fitting import Task
from jointid.learning.noise import position_error, seen_from
from jointid.learning.regression import gains_of, regression
from jointid.learning.structures import Structure
from jointid.learning.survey import begin, unheard
from jointid.learning.watched import watched
from jointid.model.controllers import INPUTS, PD, POSITION, FirstOrder, run
from jointid.paper.learned import loop_twin

T = 1e-3


@pytest.mark.parametrize("seed", [300, 304, 305, 319, 323, 333, 339, 342, 352, 361])
def test_a_law_s_own_regression_predicts_what_the_law_does(seed: int) -> None:
    """Filters, clocks, delays, feed-forwards: two writings of one equation, on noisy twins of all laws."""
    twin = loop_twin(seed)
    task, structure = Task(watched(twin.record), 1.0), twin.structure
    on = regression(task.watched)
    nonlinear = ("velocity_filter", "torque_filters", "reference_delay", *(("ki",) if structure.cascade else ()))
    numbers = {name: value for name, value in twin.numbers.items() if name.startswith(nonlinear)}
    standing = unheard(on)
    for _ in range(2):
        found = on.explained(structure, numbers, standing, free=False)[0]
        standing = on.standing(found)
    gains = gains_of(found, 1.0)
    for name in ("kp", "kv", "kd"):
        assert gains.get(name, 1.0) == pytest.approx(twin.numbers.get(name, 1.0), rel=2e-2), name
    residual = np.concatenate([task.residual(structure, gains)[structure.late :], np.zeros(structure.late)])
    difference = residual * on.kept - found.residual
    assert np.std(difference) < 1e-8 * np.std(task.watched.torque)


def test_a_step_of_gauss_and_newton_foretells_what_a_search_will_leave() -> None:
    twin = loop_twin(342)
    on = replace(regression(watched(twin.record)), own=True)
    far = {name: 1.1 * value for name, value in twin.numbers.items() if "filter" in name}
    near = {name: value for name, value in twin.numbers.items() if "filter" in name}
    standing = on.standing(on.explained(twin.structure, near, unheard(on), free=False)[0])
    begun = begin(on, twin.structure, [far], standing)
    here = on.explained(twin.structure, far, standing, free=False)[0]
    there = on.refined(here, standing, free=False)
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


def test_what_a_law_faster_than_the_log_sees_of_the_log_s_error() -> None:
    """An error of one sample, through the spline and the law, and back to the log's samples."""
    size, rate = 1000, 4
    law = PD(kp=3.0, kd=0.02, velocity_filter=FirstOrder(8e-4), period=T / rate).law(T)
    error = np.zeros(size)
    error[size // 2] = 1.0
    inputs = np.zeros((size * rate, INPUTS))
    at = np.minimum(np.arange(size * rate) / rate, size - 1.0)
    inputs[:, POSITION] = CubicSpline(np.arange(size), error)(at)
    seen = run(law, inputs, np.zeros(law.order)).output[::rate]
    expected: FloatArray = np.abs(np.fft.rfft(seen))
    found = seen_from(law.feedback, T, size, rate)
    assert np.allclose(found[5:], expected[5:], rtol=0.02, atol=0.01 * expected.max())


def test_every_law_is_there_under_one_name_and_every_part_can_go() -> None:
    frame = Structure(velocity_filter="first order")
    laws = list(all_laws(frame, channel=False))
    assert len(laws) == len(set(laws)) == len({one.words for one in laws})
    assert {one.law for one in laws} == {"P-P", "P-PI", "PD", "PID"}
    for law in laws:
        assert canonical(law) == law
        assert all(one.parts < law.parts or one.law != law.law for one in simpler(law))
    plain = Structure("P-P", "full", torque_filter="first order")  # also a PD with its filter on the difference
    assert Structure("PD", "difference", "first order") in set(neighbours(plain, channel=False))
