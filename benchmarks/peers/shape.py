"""The one shape that all peers have: a loop and a setting in; torque and derivatives out."""

from __future__ import annotations

import importlib.util
from abc import ABC, abstractmethod
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmarks.problem import SAMPLES, Array, Loop

_STEP = 1e-6  # relative: of a forward difference


@dataclass(frozen=True, slots=True)
class Setting:
    """How exactly a peer is asked to work.

    Attributes:
        label: in words.
        steps: of the integration within a period.
        width: of the smooth friction ``Fc tanh(v / width)``, m/s.
        method: of the integration, where there is a choice.
    """

    label: str
    steps: int = 1
    width: float = 0.0
    method: str = ""


class Peer(ABC):
    """One way to simulate a loop, ready to be called: what can be prepared once is prepared.

    Class attributes:
        title: as in the table.
        imports: modules that must be there.
        settings: from fast to exact.
        slow: samples that derivatives are measured on, and scaled up from.
    """

    title: ClassVar[str]
    imports: ClassVar[tuple[str, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]]
    slow: ClassVar[int] = SAMPLES

    def __init__(self, loop: Loop, setting: Setting) -> None:
        self.loop, self.setting = loop, setting

    @classmethod
    def absent(cls) -> str | None:
        """Return why it cannot run here; None where it can."""
        missing = [name for name in cls.imports if importlib.util.find_spec(name) is None]
        return f"{', '.join(missing)} is not installed" if missing else None

    @abstractmethod
    def torque(self, parameters: Array) -> Array:
        """Return the torque, (samples,) in N."""

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Return the torque and its derivatives by the parameters, (samples, parameters), by forward differences."""
        torque = self.torque(parameters)
        steps = _STEP * np.abs(parameters)
        moved = parameters + np.diag(steps)
        columns = [(self.torque(row) - torque) / step for row, step in zip(moved, steps, strict=True)]
        return torque, np.column_stack(columns)
