"""From a start to the least squares of a whole long record, in as few passes over it as there can be.

A pass reads every window once, and keeps of each what `groups.Sums` holds: memory does not grow with what is read but
by a kilobyte for each window. Of the first passes one window in sixteen is enough, at a sixteenth of the cost: a start
from one window is far off in the deviations of all of them. A pass over the whole that moves the parameters by less
than 0.3 of their deviations is the last.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.progress import Progress
from jointid.estimation.streaming.position_bins import Place, Places
from jointid.estimation.streaming.window import Model, NotSimulatedError, Window, looked_at, moves
from jointid.models.parameters import Parameter
from jointid.records.chunks import LongRecord
from jointid.solvers.bounds import Bounds
from jointid.uncertainty.jackknife import Sums, step_of, total

SPARSE = 16
"""Of so many windows, one is read in a first pass."""

_SPARSE_PASSES, _PASSES = 3, 12
_FEW = 8  # windows: with fewer a sparse pass says too little, and an interrupted one nothing
_THERE = 0.3  # deviations: the last step is taken, too, and what is left after it is far less
_ROUNDING = 1e-6  # of the torque


@dataclass(frozen=True, slots=True, eq=False)
class Pass:
    """What one pass over the windows found.

    Attributes:
        windows: in the order of time. places: over all of them, by the place's number.
        still: windows in which nothing was asked of the axis, and which are left out.
        ended: False where it was interrupted.
    """

    windows: tuple[Window, ...]
    places: Mapping[int, Place]
    still: int
    ended: bool = True

    def moved(self, step: FloatArray) -> Pass:
        """Return it as it is after a small step of the parameters."""
        windows = tuple(replace(w, sums=w.sums.moved(step)) for w in self.windows)
        places = {at: replace(place, sums=place.sums.moved(step)) for at, place in self.places.items()}
        return Pass(windows, places, self.still, self.ended)


@dataclass(frozen=True, slots=True, eq=False)
class End:
    """Where the passes ended.

    Attributes:
        x: the free parameters. found: of the last pass, as it is there.
        simulations: of windows, all passes together, each with its derivatives.
        passes: over the whole record.
        stop: why, in a sentence; converged: whether that is a good end.
    """

    x: FloatArray
    found: Pass
    simulations: int
    passes: int
    stop: str
    converged: bool


@dataclass(frozen=True, slots=True, eq=False)
class _Before:
    """The last pass that a step was taken from: where, over one window in how many, and the residual's mean square."""

    x: FloatArray | None = None
    every: int = 0
    level: float = math.inf
    found: Pass | None = None


def _rounding(sums: Sums) -> float:
    """Return the mean square of a residual that is as good as none."""
    return _ROUNDING**2 * sums.size / sums.rows


@dataclass(slots=True)
class Passes:
    """A long record on its way down.

    Attributes:
        source: the record. model: what is identified. free: its free parameters, in order.
        length: samples that count in a window. places: that repeat.
        progress: is told where it is.
    """

    source: LongRecord
    model: Model
    free: tuple[Parameter, ...]
    length: int
    places: Places
    progress: Progress
    simulations: int = field(default=0, init=False)

    def at(self, x: FloatArray, every: int) -> Pass:
        """Pass over one window in so many; an interrupt ends it with what it has.

        Raises:
            RecordError: a piece of the record cannot be read.
            NotSimulatedError: a window cannot be simulated with these parameters.
        """
        values = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        windows: list[Window] = []
        places: dict[int, Place] = {}
        still = 0
        try:
            for piece in self.source.chunks(self.length, 2 * self.model.settling, every):
                if not moves(piece.record):
                    still += 1
                    continue
                found = looked_at(piece, self.model, values, self.places)
                self.simulations += 1
                if found is None:
                    continue
                window, there = found
                for place, said in there.items():
                    places[place] = places[place] + said if place in places else said
                windows.append(window)
                self._tell(windows, every)
        except KeyboardInterrupt:
            return Pass(tuple(windows), places, still, ended=False)
        return Pass(tuple(windows), places, still)

    def _tell(self, windows: list[Window], every: int) -> None:
        """Say where a pass is, less and less often."""
        count = len(windows)
        if every == 1 and count >= _FEW and count % max(10 ** (len(str(count)) - 1), _FEW) == 0:
            seen = total([w.sums for w in windows])
            error = 100 * math.sqrt(seen.square / seen.size)
            self.progress(f"{count} windows, {windows[-1].end / 3600:.2f} h: torque error {error:.4f} %")

    def down(self, x: FloatArray) -> End:
        """Go down from x, within the bounds.

        Raises:
            NotSimulatedError: a window cannot be simulated at x.
            MethodError: in no window does the axis move.
        """
        bounds = Bounds.of(self.free)
        x, every, whole, before = bounds.clip(x), SPARSE, 0, _Before()
        for number in range(1, _PASSES + 1):
            found = self._passed(x, every, before)
            whole += every == 1
            if found is None:
                assert before.x is not None
                x = 0.5 * (x + before.x)
                continue
            if every > 1 and len(found.windows) < _FEW:
                every = 1
                continue
            if not found.windows:
                raise MethodError("In no window of this record does the axis move; give another record.")
            sums = total([w.sums for w in found.windows])
            level = sums.square / sums.rows
            step = step_of(sums, bounds.around(x))
            far = math.sqrt(float(step @ sums.A @ step) / level) if level > 0 else 0.0
            there = far < _THERE or level <= _rounding(sums)  # where nothing is left, nothing is a deviation
            if not found.ended or (every == 1 and there):
                return self._end(x, step, found, whole, far)
            before, x = _Before(x, every, level, found), x + step
            self.progress(f"{len(found.windows)} windows move the parameters by {far:.2g} deviations")
            if number >= _SPARSE_PASSES or far < 1.0:
                every = 1
        assert before.x is not None
        assert before.found is not None
        stop = "not converged: the last passes led uphill, or still moved the parameters"
        return End(before.x, before.found, self.simulations, whole, stop, False)

    def _passed(self, x: FloatArray, every: int, before: _Before) -> Pass | None:
        """Return a pass; None where a step led uphill, or to what cannot be simulated.

        Raises:
            KeyboardInterrupt: it was interrupted, and says too little.
            NotSimulatedError: a window cannot be simulated at the start.
        """
        try:
            found = self.at(x, every)
        except NotSimulatedError:
            if before.x is None:
                raise
            return None
        if not found.ended:
            if every > 1 or len(found.windows) < _FEW:
                raise KeyboardInterrupt
            return found
        if before.every == every and found.windows:
            sums = total([w.sums for w in found.windows])
            return None if sums.square / sums.rows > max(before.level, _rounding(sums)) else found
        return found

    def _end(self, x: FloatArray, step: FloatArray, found: Pass, whole: int, far: float) -> End:
        moved = found.moved(step)
        if not found.ended:
            stop = f"interrupted after {len(found.windows)} windows ({found.windows[-1].end / 3600:.3g} h)"
            return End(x + step, moved, self.simulations, whole, stop, False)
        stop = f"converged: the last pass moved the parameters by {far:.2g} deviations (limit {_THERE:g})"
        return End(x + step, moved, self.simulations, whole, stop, True)
