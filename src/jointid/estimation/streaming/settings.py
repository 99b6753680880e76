"""Settings of an identification of a long log."""

from __future__ import annotations

import math
from dataclasses import dataclass

from jointid.common.errors import MethodError


@dataclass(frozen=True, slots=True)
class Windowing:
    """How a log that is too long for memory is cut into windows.

    Attributes:
        length: seconds of a window that are fitted.
        settling: seconds before and after each window that are simulated and not fitted; None measures how long the
            loop takes to forget its initial state.

    Raises:
        MethodError: a length that is not positive and finite, or a settling time beyond half of it.
    """

    length: float = 60.0
    settling: float | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.length < math.inf:
            raise MethodError(f"A window lasts a finite time; received {self.length:g} s.")
        if self.settling is not None and not 0.0 < self.settling <= 0.5 * self.length:
            raise MethodError(
                f"The settling time is more than 0 and at most half a window of {self.length:g} s; received "
                f"{self.settling:g} s. Without it, it is measured."
            )
