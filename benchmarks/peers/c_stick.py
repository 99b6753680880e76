"""The measuring stick: a plain C version of the same stepper, for its own law; it lies beside the real records."""

from __future__ import annotations

import ctypes
import importlib
import math
import os
import shutil
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.shape import Peer, Setting
from benchmarks.problem import NAMES, Array, Loop

_ROOT = Path(__file__).resolve().parents[2]


def stick_folder() -> Path | None:
    """Return the folder of the measuring stick: beside that of the real records, found as the tests find it."""
    named = os.environ.get("JOINTID_DATA")
    places = [*([Path(named)] if named else []), _ROOT.parent / "shared" / "data"]
    return next((p.parent / "bench" for p in places if (p.parent / "bench" / "stick.py").is_file()), None)


def stick_module(name: str) -> ModuleType:
    """Load a module of the stick's; nothing is written beside it."""
    folder = stick_folder()
    if folder is None:
        raise ModuleNotFoundError("There is no measuring stick beside the real records; set JOINTID_DATA.")
    if str(folder) not in sys.path:
        sys.path.append(str(folder))
    writes, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    try:
        return importlib.import_module(name)
    finally:
        sys.dont_write_bytecode = writes


class CStick(Peer):
    """`sim` and `sim_sens` of exact.c, called with their arrays prepared."""

    title = "plain C (the stick)"
    settings = (Setting("exact"),)

    def __init__(self, loop: Loop, setting: Setting) -> None:
        super().__init__(loop, setting)
        stick = stick_module("stick")
        stick.c_sim()  # builds it
        self.library, self.law = stick._lib, stick._ctl
        self.library.sim.restype = self.library.sim_sens.restype = None
        self.w, self.start = np.ascontiguousarray(loop.feedforward), ctypes.c_double(float(loop.reference[0]))
        self.samples = ctypes.c_int(loop.samples)
        self.found, self.counts = np.empty(loop.samples), np.zeros(2, np.int64)
        self.columns = _aligned((loop.samples, len(NAMES)))

    @classmethod
    def absent(cls) -> str | None:
        """It is built where it is used."""
        if stick_folder() is None:
            return "it lies beside the real records, which are not here"
        return "there is no gcc" if shutil.which("gcc") is None else None

    def torque(self, parameters: Array) -> Array:
        """Return the torque, in the same array every time."""
        self.library.sim(
            self.samples, _at(parameters), ctypes.byref(self.law), _at(self.w), self.start, _at(self.found), None,
            _at(self.counts),
        )  # fmt: skip
        return self.found

    def slopes(self, parameters: Array) -> tuple[Array, Array]:
        """Return the torque and its derivatives, in the same arrays every time."""
        self.library.sim_sens(
            self.samples, _at(parameters), ctypes.byref(self.law), _at(self.w), self.start, _at(self.found),
            _at(self.columns), _at(self.counts),
        )  # fmt: skip
        return self.found, self.columns


def _aligned(shape: tuple[int, ...]) -> Array:
    """Return an array that begins at a multiple of 64 bytes, as a vector of eight numbers must."""
    size = math.prod(shape)
    raw = np.empty(size + 8)
    skip = (-raw.ctypes.data // 8) % 8
    return raw[skip : skip + size].reshape(shape)


def _at(array: NDArray[Any]) -> ctypes.c_void_p:
    return array.ctypes.data_as(ctypes.c_void_p)
