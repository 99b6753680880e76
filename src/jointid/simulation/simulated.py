"""Common result of simulations of a joint (exact) and a robot (finite order)."""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol, TypeVar

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.parameters import POSITION_UNIT, TORQUE_UNIT

FINISHED = "the simulation finished"
"""How a run ended that nothing ended early."""

TORQUE_OF = {POSITION_UNIT[kind]: TORQUE_UNIT[kind] for kind in POSITION_UNIT}
"""Unit of a torque by the unit of the position it moves."""


class Simulated(Protocol):
    """One candidate's run along a record."""

    @property
    def torque(self) -> FloatArray:
        """Torque as logged, (samples,), or (samples, n) for a robot; held after a failure."""

    @property
    def outcome(self) -> StrEnum:
        """How the run ended, as a sentence; `FINISHED` on success."""

    @property
    def finished(self) -> float:
        """Simulated share of the record."""

    @property
    def events(self) -> int:
        """Number of located reversals, stops and starts."""


Run = TypeVar("Run", bound=Simulated)


def require_success(run: Run, of_what: str = "The simulation") -> Run:
    """Return a run that finished.

    Raises:
        MethodError: it failed; the sentence states progress and reason.
    """
    if run.outcome != FINISHED:
        raise MethodError(
            f"{of_what} stopped after {100 * run.finished:.1f} % of the record because {run.outcome.value}; check the "
            "controller's gains and the parameters' values."
        )
    return run
