"""The one shape that all peers have: a loop and a setting in; torque, derivatives and a batch out."""

from __future__ import annotations

import importlib.util
import multiprocessing
from abc import ABC, abstractmethod
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from benchmarks.problem import PERIOD, SAMPLES, TRUTH, Array, Loop

CORES = 2
"""That a batch may use."""

_STEP = 1e-6  # relative: of a forward difference


@dataclass(frozen=True, slots=True)
class Setting:
    """How exactly a peer is asked to work.

    Attributes:
        label: in words.
        steps: of the integration within a period.
        friction: "exact"; "held", a force that stops the mass at the end of a step, as far as Coulomb's goes; or
            "smooth", ``Fc tanh(v / width)``.
        width: m/s.
        method: of the integration, where there is a choice.
        error: the worst torque error it may have, as a share of the peak; what the tests ask for.
    """

    label: str
    steps: int = 1
    friction: str = "exact"
    width: float = 0.0
    method: str = ""
    error: float = 0.1


class Peer(ABC):
    """One way to simulate a loop, ready to be called: what can be prepared once is prepared.

    Class attributes:
        key, title: short, and as in the tables.
        imports: modules that must be there. requires: what is installed for them.
        settings: from fast to exact.
        model, derivatives, many: what it does about friction and time, derivatives and batches, in a sentence each.
        slow: samples that derivatives and batches are measured on, and scaled up from.
        batch_size: candidates that a batch is measured with, and scaled up from.
    """

    key: ClassVar[str]
    title: ClassVar[str]
    imports: ClassVar[tuple[str, ...]] = ()
    requires: ClassVar[tuple[str, ...]] = ()
    settings: ClassVar[tuple[Setting, ...]]
    model: ClassVar[str]
    derivatives: ClassVar[str] = "forward differences, nine simulations"
    many: ClassVar[str]
    slow: ClassVar[int] = SAMPLES
    batch_size: ClassVar[int] = 1000

    def __init__(self, loop: Loop, setting: Setting) -> None:
        self.loop, self.setting = loop, setting

    @classmethod
    def absent(cls, loop: Loop | None = None) -> str | None:
        """Return why it cannot run here, or not this loop; None where it can."""
        missing = [name for name in cls.imports if not _installed(name)]
        return f"{', '.join(missing)} is not installed" if missing else None

    @abstractmethod
    def torque(self, parameters: Array) -> Array:
        """Return the torque, (samples,) in N."""

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Return the torque and its derivatives by the parameters, (samples, parameters)."""
        torque = self.torque(parameters)
        columns = [(self.torque(moved) - torque) / by for moved, by in _moved(parameters)]
        return torque, np.column_stack(columns)

    @abstractmethod
    def batch(self, candidates: Array) -> Sequence[Array]:
        """Return the torques of many candidates, on two cores, (samples,) each, as the peer keeps them."""


class InProcesses(Peer):
    """A peer without threads of its own: two processes, begun before anything is measured."""

    batch_size = 8
    _pool: ProcessPoolExecutor | None = None

    def batch(self, candidates: Array) -> Sequence[Array]:
        """Share the candidates between processes that have prepared the loop before."""
        if self._pool is None:
            self._pool = ProcessPoolExecutor(
                CORES, multiprocessing.get_context("spawn"), _prepare, (type(self), self.loop, self.setting)
            )
        return list(self._pool.map(_simulate, candidates))


_prepared: list[Peer] = []  # of a worker process


def _prepare(kind: type[Peer], loop: Loop, setting: Setting) -> None:
    _prepared.append(kind(loop, setting))


def _simulate(parameters: Array) -> Array:
    return _prepared[0].torque(parameters)


def perturbed(parameters: Array) -> tuple[Array, Array]:
    """Return the parameters and each of them moved, (1 + parameters, parameters), and by how much."""
    moved, by = zip(*_moved(parameters), strict=True)
    return np.vstack([parameters, *moved]), np.array(by)


def _moved(parameters: Array) -> list[tuple[Array, float]]:
    steps = _STEP * np.abs(parameters)
    return [(parameters + step * unit, float(step)) for step, unit in zip(steps, np.eye(steps.size), strict=True)]


def rates(parameters: Array = TRUTH) -> Array:
    """Return the sliding joint as a linear system, (4, 6): of the states q1, v1, q2, v2 and the forces on both masses.

    What drives it is the torque less the motor's Coulomb force, and less the load's.
    """
    m1, v1, _, k, d, m2, v2, _ = parameters
    return np.array(
        [
            [0.0, 1.0, 0.0, 0.0, 0.0, 0.0],
            [-k / m1, -(v1 + d) / m1, k / m1, d / m1, 1 / m1, 0.0],
            [0.0, 0.0, 0.0, 1.0, 0.0, 0.0],
            [k / m2, d / m2, -k / m2, -(v2 + d) / m2, 0.0, 1 / m2],
        ]
    )


def step_of(setting: Setting) -> float:
    """Return the step of the integration, s."""
    return PERIOD / setting.steps


def _installed(module: str) -> bool:
    try:
        return importlib.util.find_spec(module) is not None
    except ModuleNotFoundError:  # of a parent
        return False
