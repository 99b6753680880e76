"""Change of the torque by one fault of loop, log or mechanics."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.common.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class FaultSignature:
    """Change of the torque by one fault of loop, log or mechanics.

    Attributes:
        name: of the fault.
        column: (rows,) change of the filtered torque per unit of its size: a derivative, or of a size that was tried.
        shape: the level of a limit, a Stribeck speed, a gap or a frequency that was tried; None where the fault has
            no shape.
        tried: how many shapes this one was chosen from.
        raw: (samples,) the column before the filter, where a problem has no parameter for the fault.
    """

    name: str
    column: FloatArray
    shape: float | None = None
    raw: FloatArray | None = None
    tried: int = 1
