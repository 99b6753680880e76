"""What is refused in planning a test, each by the type of its exception."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.planning.predict import Noise, PredictedTest, parse_goal
from jointid.uncertainty.covariance import covariance_of
from tests.planning.test_joint_design import AXIS, NOISE, short_record
from tests.planning.test_robot_design import LIMITS
from tests.rigid_axis import LOOP, recorded
from tests.robots_plants import two

WIDE = ji.AxisLimits(stroke=0.2, speed=0.2, acceleration=2.0, torque=200.0)


def plan(**given: Any) -> Any:
    """Plan a test of the twin, in which something is wrong."""
    asked = {"duration": 4.0, "sample_time": 1e-3, "limits": WIDE, "goal": "stiffness"} | given
    return ji.design(AXIS.loop, values=AXIS.truth, noise=NOISE, **asked)


@pytest.mark.parametrize(
    "asked",
    [
        lambda: plan(duration=-1.0),
        lambda: plan(duration=0.05),
        lambda: plan(search_time=0.0),
        lambda: plan(within=-3.0),
        lambda: plan(goal="stiffness + damping"),
        lambda: plan(goal="nothing"),
        lambda: plan(feed_forward="gravity"),
        lambda: plan(limits=[WIDE, WIDE]),
        lambda: plan(limits=ji.AxisLimits(speed=1.0, acceleration=1.0)),
        lambda: plan(duration=None, sample_time=None),
        lambda: ji.design(AXIS.loop),
        lambda: ji.design(two().robot, short_record()),
        lambda: ji.design(two().robot, [short_record()]),
        lambda: ji.design(two().robot, values={}),
        lambda: ji.design(two().robot, limits=(ji.AxisLimits(lower=0.0), LIMITS[1])),
        lambda: ji.design(two().robot, limits=LIMITS[:1]),
        lambda: ji.design(two().robot, limits=LIMITS, duration=0.01),
        lambda: ji.design(two((9.0, None)).robot, limits=LIMITS),
        lambda: ji.AxisLimits(lowest=200.0, highest=30.0),
        lambda: ji.AxisLimits(lower=1.0, upper=0.5),
        Noise,
        lambda: Noise(log=-1.0),
    ],
)
def test_what_cannot_be_planned_is_refused(asked: Callable[[], Any]) -> None:
    with pytest.raises(ji.MethodError):
        asked()


def test_an_estimate_has_its_own_values() -> None:
    record = recorded()
    with pytest.raises(ji.MethodError):
        ji.design(ji.identify(record, LOOP, checks=False), record, values={})


def test_offsets_alone_have_a_score_too() -> None:
    known = covariance_of(np.array([[0.01]]))
    told = PredictedTest(("offset",), {}, {}, {"offset": 2.0}, known, np.zeros((1, 1)), 1.0, ())
    score = parse_goal("all", {"offset": "N"}).score(told)
    assert score == pytest.approx(np.log(0.1 / 2.0))
