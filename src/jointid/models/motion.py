"""The motion of one side of a joint."""

from __future__ import annotations

from dataclasses import dataclass

from jointid.common.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """The motion of one side of a joint, each (samples,)."""

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
