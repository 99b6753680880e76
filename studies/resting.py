"""Random servos that stand, or move, where their log begins, and the motion they had."""

from __future__ import annotations

from dataclasses import dataclass

import jointid as ji
from tests.servos import servo


@dataclass(frozen=True, slots=True)
class RestingRun:
    """One servo.

    Attributes:
        moves: whether the answer says that it moves when the log begins.
        z: error of the inertia, in its deviations.
    """

    moves: bool
    z: float


def judge(seed: int, moving: bool) -> RestingRun:
    """Identify a servo."""
    case = servo(seed, moving)
    found = ji.identify(case.record, case.loop, checks=False)
    inertia = found["inertia"]
    assert inertia.value is not None and inertia.stderr is not None
    return RestingRun(bool(found["initial_velocity"].free), (inertia.value - case.truth["inertia"]) / inertia.stderr)
