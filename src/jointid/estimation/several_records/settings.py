"""Settings of an identification from several records of one joint."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

from jointid.common.errors import MethodError

Weighting: TypeAlias = Literal["spectrum", "level"]


@dataclass(frozen=True, slots=True)
class SeveralRecords:
    """How several records of one joint belong together.

    Attributes:
        added_inertia: for each record, the known inertia added to the load: kg, or kg m2; None for none.
        own: for each record, names of parameters of its own, which the others do not share: friction, say, which a
            load changes. The motor's state at the first sample is always its own.
        free: names of nuisance parameters to identify too: "drive_gain", the torque that acts over the torque in the
            log, which needs an added inertia; "kp", "log_delay", ...
        weighting: of the rows: by the "spectrum" of each record's residual, unless it repeats with the motion, or by
            its "level" alone.

    Raises:
        MethodError: the weighting is not one of the two.
    """

    added_inertia: Sequence[float] | None = None
    own: Sequence[Sequence[str]] | None = None
    free: Sequence[str] = ()
    weighting: Weighting = "spectrum"

    def __post_init__(self) -> None:
        if self.weighting not in ("spectrum", "level"):
            raise MethodError(f'The weighting is one of spectrum, level; received "{self.weighting}".')
