"""MuJoCo's system-identification toolbox on the paper's axis: its own least squares around its own simulation."""

from __future__ import annotations

import contextlib
import importlib.util
import io
from typing import Any

import numpy as np

from benchmarks.peers.mujoco_step import MujocoStep
from benchmarks.problem import EMPS, NAMES, PERIOD, Array, Law, Loop
from benchmarks.results import Solver
from benchmarks.searching import summed, timed
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.paper.twin import CONTROLLERS, Twin
from jointid.records.record import Channel

TITLE = "mujoco.sysid"

_IMPORTS = ("mujoco", "absl", "tabulate", "yaml")  # the toolbox, and what its extra brings
_FEW = 3  # starts: each takes minutes
_SETTING = next(setting for setting in MujocoStep.settings if setting.label == "RK4, 1 step")
_STEP = 1e-5  # of a difference: the toolbox's own is lost in the tolerance of MuJoCo's constraint solver
_ROOM = 30.0  # factor to the bounds, either way
_ITERATIONS = 60


def with_toolbox(axis: Twin, problem: ClosedLoopProblem, starts: Array, best: float) -> Solver:
    """Return what the toolbox comes to from the first few starts, or that it is not installed."""
    missing = [name for name in _IMPORTS if importlib.util.find_spec(name) is None]
    if missing:
        return Solver(TITLE, 0, (), (), (), (), f"left out: {', '.join(missing)} not installed")
    loop = loop_of_twin(axis)
    runs = [timed(lambda p, x: _optimised(loop, p, x), problem, start) for start in starts[:_FEW]]
    return summed(
        TITLE, runs, best, f"{_SETTING.label} of {1e3 * PERIOD:g} ms, what is left judged by the exact simulation"
    )


def loop_of_twin(axis: Twin) -> Loop:
    """Return the twin's loop as the peers read it; its pulses act behind a limit that is never reached."""
    controller = CONTROLLERS["L19"]
    velocity_gain = controller.velocity_gain * controller.gain
    law = Law(
        "twin",
        "the twin's loop",
        controller.position_gain * velocity_gain,
        velocity_gain,
        EMPS.memory,
        EMPS.now,
        EMPS.before,
        1e9,
        False,
    )
    reference, injected = axis.record.reference, axis.record.injected
    assert isinstance(reference, Channel)
    assert injected is not None
    return Loop(law, reference.values, np.zeros(reference.values.size), injected.channel.values)


def _optimised(loop: Loop, problem: ClosedLoopProblem, start: Array) -> tuple[Array, int]:
    """Search the logarithms of the parameters, as shares of the start, which all have its sign."""
    from mujoco import sysid

    names = [p.name for p in problem.free]
    order = [names.index(name) for name in NAMES]
    peer = MujocoStep(loop, _SETTING)
    size = float(np.linalg.norm(problem.filter(problem.measured)))
    simulations = 0

    def residual(x: Array, _parameters: Any) -> tuple[list[Array], None, None]:
        nonlocal simulations
        columns = x.reshape(len(names), -1)
        values = start * np.exp(columns.T)
        simulations += len(values)
        torque = peer.batch(values[:, order], values[:, names.index("offset")])
        error = np.nan_to_num(
            problem.measured - np.array(torque), nan=1e3 * size, posinf=1e3 * size, neginf=-1e3 * size
        )
        found = problem.filter(error.T) / size
        return [found if x.ndim > 1 else found[:, 0]], None, None

    given = sysid.ParameterDict()
    for name in names:
        given.add(sysid.Parameter(name, 0.0, -np.log(_ROOM), np.log(_ROOM)))
    with contextlib.redirect_stdout(io.StringIO()):  # it has no word to be quiet: its `verbose` is another's
        _, found = sysid.optimize(
            given, residual, "mujoco", verbose=False, max_iters=_ITERATIONS, eps=_STEP, x_scale="jac"
        )
    return np.asarray(start * np.exp(np.ravel(found.x))), simulations
