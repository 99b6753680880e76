"""What is refused in planning a test, each by the type of its exception."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.models.limits import AxisLimits
from jointid.paper.twin import twin
from jointid.planning.goals import parse_goal
from jointid.planning.predict import Noise, planned_record, predict_test
from jointid.records.record import Record
from tests.planning.test_joint_design import AXIS, NOISE, PLAIN, PLAIN_VALUES, short_record
from tests.planning.test_robot_design import LIMITS
from tests.robots_plants import two

WIDE = AxisLimits(stroke=0.2, speed=0.2, acceleration=2.0, torque=200.0)
STILL = planned_record(PLAIN, np.zeros(3000), 1e-3)
ONE_WAY = planned_record(PLAIN, np.arange(3000) * 2e-4, 1e-3)
FAST = replace(PLAIN, controller=ji.controller.Cascade(position_gain=40.0, velocity_gain=2e4))


def plan(**given: Any) -> Any:
    """Plan a test of the twin, in which something is wrong."""
    asked = {"duration": 4.0, "sample_time": 1e-3, "limits": WIDE, "goal": "stiffness"} | given
    return ji.design(AXIS.loop, values=AXIS.truth, noise=NOISE, **asked)


def predict(test: Record, loop: ji.ClosedLoop = PLAIN) -> Any:
    return predict_test(loop, PLAIN_VALUES, test, Noise(log=0.01))


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
        lambda: plan(limits=[WIDE]),
        lambda: plan(limits=AxisLimits(speed=1.0, acceleration=1.0)),
        lambda: plan(duration=None, sample_time=None),
        lambda: ji.design(AXIS.loop),
        lambda: ji.design(two().robot, short_record()),
        lambda: ji.design(two().robot, [short_record()]),
        lambda: ji.design(two().robot, values={}),
        lambda: ji.design(two().robot, limits=(AxisLimits(lower=0.0), LIMITS[1])),
        lambda: ji.design(two().robot, limits=LIMITS[:1]),
        lambda: ji.design(two().robot, limits=LIMITS, duration=0.01),
        lambda: ji.design(two((9.0, None)).robot, limits=LIMITS),
        lambda: AxisLimits(lowest=200.0, highest=30.0),
        lambda: AxisLimits(lower=1.0, upper=0.5),
        Noise,
        lambda: Noise(log=-1.0),
        lambda: predict(STILL),
        lambda: predict(ONE_WAY),
        lambda: predict(Record(torque=STILL.reference)),
        lambda: predict(STILL, FAST),
    ],
)
def test_what_cannot_be_planned_is_refused(asked: Callable[[], Any]) -> None:
    with pytest.raises(MethodError):
        asked()


def test_an_estimate_has_its_own_values(identified: Callable[..., ji.Estimate]) -> None:
    with pytest.raises(MethodError):
        ji.design(identified("L19", noise="disturbance", seed=3), twin("L19", seed=3).record, values={})


def test_offsets_alone_have_a_score_too() -> None:
    score = parse_goal("all", {"offset": "N"}).score(np.array([[0.01]]), ["offset"], {"offset": 2.0})
    assert score == pytest.approx(np.log(0.1 / 2.0))
