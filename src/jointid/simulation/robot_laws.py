"""The controllers of a robot as the kernel reads them, one after the other."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.simulation.kernels.robot_loop import Controllers
from jointid.simulation.loop_input import LoopInput


def pack_laws(alone: Sequence[LoopInput]) -> tuple[Controllers, FloatArray]:
    """Return the controllers filled up to equal sizes, and their answers to everything but the positions.

    States that are filled up stay 0, as elements do; the answers are (n, elements, periods), each of its own periods.
    """
    kernels = [each.kernel for each in alone]
    phases = math.lcm(*(len(kernel.A) for kernel in kernels))
    states, elements = max(k.A.shape[1] for k in kernels), max(k.limits.size for k in kernels)
    sizes = {"z": states, "e": elements}

    def packed(name: str, axes: str) -> FloatArray:
        out = np.zeros((len(kernels), phases, *(sizes[axis] for axis in axes)))
        for j, kernel in enumerate(kernels):
            values = getattr(kernel, name)
            values = np.tile(values, (phases // len(values), *(1,) * len(axes)))
            inside: tuple[int | slice, ...] = (j, slice(None), *(slice(size) for size in values.shape[1:]))
            out[inside] = values
        return out

    periods, driven = max(each.periods for each in alone), any(kernel.driven.size for kernel in kernels)
    into = np.zeros((len(kernels), periods if driven else 0, states))
    limits, gates = np.full((len(kernels), elements), np.inf), np.full((len(kernels), elements), -1)
    feedforward = np.zeros((len(kernels), elements, periods))
    for j, (kernel, each) in enumerate(zip(kernels, alone, strict=True)):
        limits[j, : kernel.limits.size], gates[j, : kernel.limits.size] = kernel.limits, kernel.gates
        feedforward[j, : kernel.limits.size, : each.periods] = each.feedforward
        if kernel.driven.size:
            into[j, : each.periods, : kernel.driven.shape[1]] = kernel.driven
    shapes = {"A": "zz", "Bq": "z", "F": "ze", "C": "ez", "D": "e", "E": "ee"}
    A, Bq, F, C, D, E = (packed(name, axes) for name, axes in shapes.items())
    outputs, taps = np.array([kernel.output for kernel in kernels]), np.array([kernel.tap for kernel in kernels])
    return Controllers(A, Bq, F, C, D, E, limits, gates, into, outputs, taps), feedforward
