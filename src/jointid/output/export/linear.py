"""The linear part of a joint in files: one JSON that says everything, and a MATLAB script."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from typing import ClassVar

from jointid import __version__
from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.common.json_file import dumps
from jointid.common.transmission import Side
from jointid.output.export.joint_model import JointModel
from jointid.output.export.naming import identifier, number
from jointid.output.export.provenance import remarks
from jointid.output.export.state_space import StateSpace, linear_part, not_linear
from jointid.output.json.parts import Json, parameter_answer

STATE_SPACE_SCHEMA = "jointid.state-space/1"

_RESERVED = (
    "break", "case", "catch", "classdef", "continue", "else", "elseif", "end", "for", "function", "global", "if",
    "otherwise", "parfor", "persistent", "return", "spmd", "switch", "try", "while", "ss", "struct",
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class _Sampling:
    """The discretisation of the state space.

    Attributes:
        period: s; without it the record's sample time.
        delay: s, from a sample of the torque to its effect; without it as the joint was identified with.

    Raises:
        MethodError: one of them is impossible.
    """

    period: float | None = None
    delay: float | None = None

    def __post_init__(self) -> None:
        if not (self.period is None or 0 < self.period < math.inf) or not (
            self.delay is None or 0 <= self.delay < math.inf
        ):
            raise MethodError(
                f"A period is a positive number of seconds, a delay 0 or more; received {self.period} and {self.delay}."
            )

    def lost(self, model: JointModel) -> tuple[str, ...]:
        """Return a sentence for each part of the joint that is not linear, or constant."""
        return not_linear(model)

    def sampled(self, model: JointModel) -> StateSpace:
        """Return the sampled state space.

        Raises:
            MethodError: nothing says the period.
        """
        period = self.period or model.sample_time
        if period is None:
            raise MethodError("The records have sample times of their own; give the period to sample with.")
        return linear_part(model).sampled(period, model.delay if self.delay is None else self.delay)


@dataclass(frozen=True, slots=True)
class StateSpaceJson(_Sampling):
    """A state space as JSON, schema `jointid.state-space/1`, for SciPy, python-control and whatever reads numbers."""

    name: ClassVar[str] = "state-space"
    described: ClassVar[str] = "JSON: linear state space, continuous and sampled, with every parameter"
    suffixes: ClassVar[tuple[str, ...]] = (".json",)
    side: ClassVar[Side | None] = None

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            MethodError: a value is refused, no joint can have it, or nothing says the period.
        """
        continuous, origin = linear_part(model), model.origin
        answer: Json = {
            "schema": STATE_SPACE_SCHEMA,
            "jointid": __version__,
            "name": model.name,
            "model": model.joint.model,
            "kind": model.kind,
            "side": model.side,
            "motor_torque_to_input": model.gear,
            "units": dict(continuous.units),
            "continuous": _matrices(continuous),
            "sampled": _matrices(self.sampled(model)),
            "parameters": {p.name: parameter_answer(p) for p in model.parameters},
            "source": {
                "schema": origin.schema,
                "method": origin.method or None,
                "records": [
                    {"name": name, "torque_sha256": mark or None}
                    for name, mark in zip(origin.records, origin.fingerprints, strict=True)
                ],
            },
            "lost": list(self.lost(model)),
        }
        return dumps(answer)


@dataclass(frozen=True, slots=True)
class Matlab(_Sampling):
    """A MATLAB script that makes two models of the Control System Toolbox; Octave's `control` package has the same."""

    name: ClassVar[str] = "matlab"
    described: ClassVar[str] = "MATLAB: a script with ss(A, B, C, D), continuous and sampled"
    suffixes: ClassVar[tuple[str, ...]] = (".m",)
    side: ClassVar[Side | None] = None

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            MethodError: a value is refused, no joint can have it, or nothing says the period.
        """
        continuous, sampled = linear_part(model), self.sampled(model)
        name = identifier(model.name, _RESERVED)
        units = ", ".join(f"{signal} {unit}" for signal, unit in continuous.units.items())
        lines = [f"% {line}" for line in (*remarks(model, self.lost(model)), f"Units: {units}")]
        if model.gear != 1.0:
            lines.append(f"% The input is {number(model.gear)} times the motor's own torque.")
        for system, suffix in ((continuous, ""), (sampled, "_sampled")):
            lines += ["", f"{name}{suffix} = struct();", *_assigned(f"{name}{suffix}", system)]
        return "\n".join(lines) + "\n"


def _matrices(system: StateSpace) -> Json:
    timed = {} if system.period is None else {"period": system.period, "delay": system.delay}
    return timed | {
        "states": list(system.states),
        "inputs": list(system.inputs),
        "outputs": list(system.outputs),
        **{letter: getattr(system, letter).tolist() for letter in "ABCD"},
    }


def _assigned(name: str, system: StateSpace) -> list[str]:
    """Return the lines that give a structure its matrices and, where the toolbox is there, its model."""
    lines = [f"{name}.{letter} = {_matrix(getattr(system, letter))};" for letter in "ABCD"]
    timed = "" if system.period is None else f", {number(system.period)}"
    words = [
        f"'{key}', {{{', '.join(_quoted(signal) for signal in signals)}}}"
        for key, signals in (
            ("StateName", system.states), ("InputName", system.inputs), ("OutputName", system.outputs)
        )
    ]  # fmt: skip
    matrices = ", ".join(f"{name}.{letter}" for letter in "ABCD")
    return [*lines, f"{name}.sys = ss({matrices}{timed}, {', '.join(words)});"]


def _quoted(name: str) -> str:
    return f"'{name}'"


def _matrix(values: FloatArray) -> str:
    def row(numbers: Iterable[float]) -> str:
        return " ".join(number(value) for value in numbers)

    return f"[{'; '.join(row(numbers) for numbers in values)}]"
