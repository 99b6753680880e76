"""The base of every problem of one record: its parameters by name and as a vector, and what it is measured against."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Self

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.models.parameters import Parameter
from jointid.records.signals.filtering import Filtering

if TYPE_CHECKING:
    from jointid.models.joints import Joint

FAILED = 1e3  # times the measured signal: the error of a candidate that cannot be simulated


@dataclass(frozen=True, slots=True, eq=False)
class RecordProblem:
    """A record and a model of it: free parameters in, the filtered error out; the base of a `solvers.problem.Problem`.

    Attributes:
        parameters: all of the joint, then of what surrounds it.
        measured: (samples,) what is reproduced, raw.
        filtering: resolved.
    """

    parameters: tuple[Parameter, ...]
    measured: FloatArray
    filtering: Filtering

    if TYPE_CHECKING:

        @property
        def joint(self) -> Joint:
            """What is identified."""

        @property
        def sample_time(self) -> float:
            """Of the measured signal, seconds."""

        def filtered(self, columns: FloatArray) -> FloatArray:
            """Return signals, (samples,) or (samples, columns), through the problem's own filter, decimated."""

    @property
    def free(self) -> tuple[Parameter, ...]:
        """The parameters that are identified."""
        return tuple(p for p in self.parameters if p.free)

    @property
    def free_joint(self) -> tuple[Parameter, ...]:
        """Those of them that belong to the joint; they come first."""
        own = {p.name for p in self.joint.parameters}
        return tuple(p for p in self.free if p.name in own)

    @property
    def units(self) -> dict[str, str]:
        """Of every parameter, by name."""
        return {p.name: self.joint.unit(p) for p in self.parameters}

    @property
    def size(self) -> float:
        """Norm of the filtered signal: what a residual is measured against."""
        return float(np.linalg.norm(self.filtered(self.measured)))

    def values(self, x: FloatArray) -> dict[str, float]:
        """Return every parameter by name, the fixed ones too."""
        found = dict(zip((p.name for p in self.free), map(float, x), strict=True))
        return {p.name: found.get(p.name, float(p.start or 0.0)) for p in self.parameters}

    def vector(self, values: Mapping[str, float]) -> FloatArray:
        """Return the free parameters of `values`, in order; one that is not there starts as declared."""
        return np.array([values.get(p.name, p.start or 0.0) for p in self.free])

    def changed(self, changes: Mapping[str, Parameter]) -> Self:
        """Return the problem with the parameters of these names replaced; others are not added."""
        return replace(self, parameters=tuple(changes.get(p.name, p) for p in self.parameters))

    def keeping(self, values: Mapping[str, float]) -> Self:
        """Return the problem with parameters fixed at these values, by name; others are not added."""
        return self.changed({p.name: p.fixed(values[p.name]) for p in self.parameters if p.name in values})

    def all_free(self) -> Self:
        """Return the problem with every parameter free, so that every derivative is there."""
        return self.changed({p.name: replace(p, free=True) for p in self.parameters})
