"""Random servos that stand, or move, where their log begins: one answer from either start, and the motion they had."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

import jointid as ji
from tests.servos import servo

STARTS = ("inversion", "regular")


@dataclass(frozen=True, slots=True)
class RestingRun:
    """One servo.

    Attributes:
        moves: whether each answer says that it moves when the log begins.
        apart: ratio of the larger error to the smaller one.
        z: error of the better inertia, in its deviations.
    """

    moves: tuple[bool, ...]
    apart: float
    z: float


def judge(seed: int, moving: bool) -> RestingRun:
    """Identify a servo from either start; one that moves from the first alone."""
    case = servo(seed, moving)
    found = [
        ji.identify(case.record, case.loop, ji.DIDIM("least-squares", start), checks=False)  # type: ignore[arg-type]
        for start in (STARTS[:1] if moving else STARTS)
    ]
    errors = [estimate.fit.filtered_error for estimate in found]
    inertia = found[int(np.argmin(errors))]["inertia"]
    assert inertia.value is not None and inertia.stderr is not None
    return RestingRun(
        tuple(bool(estimate["initial_velocity"].free) for estimate in found), max(errors) / min(errors),
        (inertia.value - case.truth["inertia"]) / inertia.stderr,
    )  # fmt: skip
