"""Reference for laws: a regression of torque on recent reference and position.

The regression contains almost any law of linear filters and loops. If a law leaves much more than the regression at
informative frequencies, the drive has another law.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.noise import lagged_columns, regress, signal_and_past
from jointid.models.controllers import DIRECTION, INJECTED, POSITION, REFERENCE, REFERENCE_VELOCITY

LAGS = 16  # samples of reference and position
_BESIDE = 4  # samples of what else a law reads
_MUCH = 3.0  # times what the regression leaves, in rms: an F of 9, of hundreds of rows
_MATERIAL = 2e-3  # of the torque's rms: a law that leaves less is good enough for whatever it is needed for


@dataclass(frozen=True, slots=True)
class BesideRegression:
    """Residual of a law compared with that of a plain regression.

    Attributes:
        law: share of the torque's rms that the law leaves.
        regression: that the regression leaves.
    """

    law: float
    regression: float

    @property
    def another(self) -> bool:
        """True if the drive's law is another."""
        return self.law > max(_MUCH * self.regression, _MATERIAL)


def compare_with_regression(log: LoopRecord, residual: FloatArray) -> BesideRegression:
    """Compare a law's residual with a plain regression.

    Only samples within the limit and informative frequencies count; elsewhere the position error dominates.

    Args:
        log: the record.
        residual: (samples,) logged less the law's torque.
    """
    inputs, kept = log.inputs(1, False), log.free
    r, q = (inputs[:, i] - inputs[0, REFERENCE] for i in (REFERENCE, POSITION))
    asked = [np.ones((r.size, 1)), np.cumsum(r - q)[:, np.newaxis], *signal_and_past(r, LAGS)]
    beside = (inputs[:, DIRECTION], inputs[:, REFERENCE_VELOCITY], inputs[:, INJECTED], log.added)
    asked += [lagged_columns(one, _BESIDE) for one in beside if np.ptp(one)]
    _, left = regress(asked, signal_and_past(q, LAGS), log.torque, kept)
    size = math.sqrt(float(np.mean((log.torque * kept) ** 2))) or 1.0
    law, plain = (_heard(one * kept, log.informative) / size for one in (residual, left))
    return BesideRegression(law, plain)


def _heard(signal: FloatArray, informative: FloatArray) -> float:
    """Rms of a signal at the informative frequencies."""
    heard = np.fft.irfft(np.fft.rfft(signal) * (informative > 0), signal.size)
    return math.sqrt(float(np.mean(heard**2)))
