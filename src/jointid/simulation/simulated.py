"""The answer that every simulation gives: of one joint, exact to rounding, and of a robot, to the order that it states.

`closed_loop.simulate` and `robots.simulate_robot` run a candidate, never raise for its sake, and say how the run ended.
What compares torques, writes them or draws them needs no more than this, and does not see which of them it was.
"""

from __future__ import annotations

from enum import StrEnum
from typing import Protocol, TypeVar

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError

FINISHED = "the simulation finished"
"""How a run ended that nothing ended early."""


class Simulated(Protocol):
    """One candidate's run along a record."""

    @property
    def torque(self) -> FloatArray:
        """The torque as the record would show it, (samples,), or of a robot (samples, n); held after a failure."""

    @property
    def outcome(self) -> StrEnum:
        """How the run ended, as the sentence to print; `FINISHED` for one joint and for a robot."""

    @property
    def finished(self) -> float:
        """The share of the record that was simulated."""

    @property
    def events(self) -> int:
        """Reversals, stops and starts that were located."""


Run = TypeVar("Run", bound=Simulated)


def require_finished(run: Run, of_what: str = "The simulation") -> Run:
    """Return a run that finished.

    Args:
        run: of a joint or a robot.
        of_what: was simulated, as the sentence begins.

    Raises:
        MethodError: it did not; the sentence says how far it came, and why no farther.
    """
    if run.outcome != FINISHED:
        raise MethodError(
            f"{of_what} stopped after {100 * run.finished:.1f} % of the record because {run.outcome.value}; check the "
            "controller's gains and the parameters' values."
        )
    return run
