"""A robot identified from several logs in one fit: the problems of the logs add up."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.diagnostics.validation import Prediction
from jointid.estimation.robots.didim import search_robot
from jointid.records.chunks import Log, cut
from jointid.simulation.plant import Numbers
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_plants import two

TWIN = two()
LOOP = TWIN.loop()
LOGS = tuple(recorded(LOOP, TWIN.records(4.0, seed), 0.01, seed)[0] for seed in (1, 4))
NOISY = recorded(LOOP, TWIN.records(4.0, 4), 0.05, 4)[0]


def test_didim_of_two_logs_knows_more_than_of_either() -> None:
    one, other, both = (search_robot(LOOP, records) for records in (LOGS[0], NOISY, (LOGS[0], NOISY)))
    assert both.converged
    truth = both.parameters.group(Numbers.of(TWIN.robot))
    assert np.all(np.abs(both.values - truth) < 5 * both.covariance.std)
    first, second, summed = (np.sum(fit.problem.weigh(fit.slopes) ** 2, axis=0) for fit in (one, other, both))
    assert summed == pytest.approx(first + second, rel=0.15)  # by shared weights a fifth at most
    assert both.relative_error == pytest.approx(np.hypot(one.relative_error, other.relative_error) / 2**0.5, rel=0.2)
    assert max(ji.identify(LOGS, LOOP, checks=False).fit.nominal_errors.values()) < 0.01  # of the twin's own masses


@pytest.mark.parametrize("estimator", ["weighted", "iv"])
def test_idim_takes_from_each_log_what_it_tells(estimator: Any) -> None:
    """The instruments are simulated along each log, too."""
    method = ji.IDIM(estimator)
    estimates: list[Any] = [ji.identify(records, LOOP, method, checks=False) for records in (*LOGS, LOGS)]
    both = estimates[-1].robot
    assert all(one.passed for estimate in estimates for one in estimate.checks if one.name == "instruments")
    one, other, spread = (estimate.covariance_of(estimate.free).std for estimate in estimates)
    information = 1 / one**2 + 1 / other**2
    # The logs tell different sums best, so together they tell each parameter better than both answers averaged.
    assert np.all(spread * np.sqrt(information) < 1.1)
    assert np.all(np.abs(both.values - both.parameters_of(TWIN.robot)) < 5 * spread)


@pytest.mark.parametrize("model", [LOOP, TWIN.robot])
def test_each_of_several_logs_is_an_own_one(model: Any) -> None:
    found = ji.identify(LOGS, model, checks=False)
    for log in LOGS:
        assert (own := ji.validate(found, log)).answer.code is Prediction.OWN_RECORD and own.nominal_error is None


@pytest.mark.slow
@pytest.mark.parametrize("hertz", [(None, None), (12.0, 15.0)])
def test_a_long_log_in_windows_says_what_the_whole_says(hertz: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """All windows but the first begin in motion; a log that is long for memory goes in windows by itself."""
    loop = two(hertz).loop()
    log = recorded(loop, two(hertz).records(20.0, multisine=0.004), 0.01, 1)[0]
    whole = ji.identify(log, loop, checks=False)
    monkeypatch.setattr("jointid.estimation.identify.LARGEST", 2 * 20_000 - 1)
    monkeypatch.setattr("jointid.estimation.identify.WINDOW", 4000)
    parts = ji.identify(log, loop)
    assert parts.data.windows is not None and parts.data.windows.count == 5
    assert parts.fit.axis_errors == pytest.approx(whole.fit.axis_errors, rel=0.05)
    for name, row in whole.parameters.items():
        assert abs(parts[name].value - row.value) < 0.7 * row.stderr, name
        assert 0.5 < parts[name].stderr / row.stderr < 2.5, name
    assert parts.robot.setup == loop and parts.answer.reliable
    assert ji.validate(parts, log).answer.code is Prediction.OWN_RECORD
    unread, said = Log("unread.csv", {"reference": "q"}), list[str]()
    shorter = [log[0], cut(log[1], 0, 8000 + round(parts.data.windows.settling / 1e-3) * 2 + 4000)]
    for wrong in (shorter, [record.without("torque") for record in log], [unread] * 2, [[unread] * 2], unread):
        with pytest.raises(ji.MethodError):
            ji.identify(wrong, loop, windows=4.0, progress=said.append)
    assert not said  # before any window is identified
    with pytest.raises(ji.RecordError, match="opened"):  # the columns of a drive's profile are read with the file
        ji.identify([replace(unread, settings={"drive": "any"})] * 2, loop, windows=4.0)
