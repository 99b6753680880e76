"""Expected time of a search by stage, and its progress."""

from __future__ import annotations

import timeit
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import numpy as np

from jointid.common.messages import Progress, Work
from jointid.controller_id.fitting import Task
from jointid.controller_id.regression import initial_weighting, regression
from jointid.controller_id.structures import Structure

FRAMES, LAWS = "screening clocks and filters, with free gains", "screening all laws with all clocks and filters"
FITTING, NEARBY, JUDGING = "fitting the likeliest laws", "trying what is near the best", "judging on the whole record"

_PROBED = 4  # periods per sample of the regression that the time of a search is expected from
_REGRESSIONS = {FRAMES: 500.0, LAWS: 800.0, FITTING: 3000.0, NEARBY: 300.0, JUDGING: 150.0}
"""Regressions like it that each stage takes as long as, measured on records of 1000 to 60,000 samples."""
_SMALL = 60000.0  # and those of few rows, by which laws are screened
_NOT_YET = 99.0  # % at most, before the end


class Course:
    """Progress of a search in % of the expected time, from progress of its stages."""

    def __init__(self, progress: Progress, seconds: Mapping[str, float]) -> None:
        self._progress, self._seconds, self._reached = progress, seconds, 0.0
        self._work = Work(progress, "learning the controller", 100.0, "%")

    def __call__(self, message: str) -> None:
        """Pass a sentence on."""
        self._progress(message)

    def draw(self, what: str, done: float, total: float, unit: str) -> None:
        """Update a stage's progress; of a repeated one, the increment."""
        del unit
        stages = list(self._seconds)
        before = sum(self._seconds[one] for one in stages[: stages.index(what)])
        reached = (before + self._seconds[what] * done / (total or 1.0)) / sum(self._seconds.values())
        if reached > self._reached:
            self._reached = reached
            self._work.reach(min(100.0 * reached, _NOT_YET))

    def end(self) -> None:
        """Report completion."""
        self._work.reach(100.0)


def expect_seconds(task: Task, stretch: Task) -> dict[str, float]:
    """Predict the time of each stage from a few timed regressions."""
    own = replace(regression(stretch.log), own=True)
    weighting, frame, longer = initial_weighting(own), Structure(rate=_PROBED), task.log.samples / stretch.log.samples
    compressed = own.compress(frame, {}, weighting, [0])
    each = _time_work(partial(own.fit_gains, frame, {}, weighting))
    seconds = {stage: many * each for stage, many in _REGRESSIONS.items()}
    of_few_rows = _time_work(partial(compressed.costs, frame, None))
    return seconds | {LAWS: seconds[LAWS] + _SMALL * of_few_rows, JUDGING: longer * seconds[JUDGING]}


def _time_work(work: Callable[[], object]) -> float:
    """Median time of a few runs, s."""
    return float(np.median(timeit.repeat(work, number=1, repeat=7)))
