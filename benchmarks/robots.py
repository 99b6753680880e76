"""How long robots take to simulate and to identify, beside MuJoCo's own stepping at its own error.

    python -m benchmarks.robots
    python -m benchmarks.robots --twelve

The closed loop: 6 joints, 10 s at 1 kHz, rigid and flexible, and MuJoCo in steps of 1 ms to 0.05 ms, the errors of both
against jointid's own run at sixteen times the steps, which an adaptive integrator with the same events confirms
(`tests/simulation/test_robots.py`). Then DIDIM. With `--twelve` that of two arms of six joints on one base alone, for
60 s at 500 Hz, and `identify` of them with all checks. Times are the shortest of several turns, taken in turn; those of
the processor are printed beside those of the clock, since a machine may have other work.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from jointid import identify
from jointid.common.arrays import FloatArray
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.robots.didim import search_robot
from jointid.simulation.loop_input import prepare
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import run_loop
from jointid.simulation.start import begin
from tests.estimation.robots.test_rigid_robots import recorded
from tests.robots_mujoco import simulate_by_mujoco
from tests.robots_plants import Twin, seven, six, two

TURNS = 5
STEPS = (1e-3, 5e-4, 2.5e-4, 1e-4, 5e-5)  # s, of MuJoCo


def shortest(call: Callable[[], object], turns: int = TURNS) -> tuple[float, float]:
    """Return the shortest of several turns after one that compiles: by the clock, and of the processor."""
    call()
    found = []
    for _ in range(turns):
        begun, spent = time.perf_counter(), time.process_time()
        call()
        found.append((time.perf_counter() - begun, time.process_time() - spent))
    return min(found)[0], min(spent for _, spent in found)


def worst(torques: FloatArray, exact: FloatArray) -> float:
    """Return the largest rms error of a joint's torque, as a share of its rms."""
    return float(np.max(np.linalg.norm(torques - exact, axis=0) / np.linalg.norm(exact, axis=0)))


def loops() -> None:
    """Print the time and the error of a closed loop, ours and MuJoCo's."""
    for name, twin in (("rigid", six()), ("flexible", six(True))):
        loop = twin.loop()
        experiment, numbers = prepare(loop, twin.records(10.0)), Numbers.of(twin.robot)
        exact = run_loop(experiment, numbers, steps=16).torque
        own = shortest(lambda: run_loop(experiment, numbers))  # noqa: B023
        print(f"{name}, times of the processor: ours {own[1]:.3f} s, ", end="")
        print(f"error {worst(run_loop(experiment, numbers).torque, exact):.1e}")
        gains = np.array([[c.position_gain, c.derivative_gain] for c in loop.controllers])  # type: ignore[attr-defined]
        start = begin(experiment, numbers).places
        for step in STEPS:

            def theirs(step: float = step) -> FloatArray:
                return simulate_by_mujoco(twin.robot, gains, experiment.references, 1e-3, start, step)[0]  # noqa: B023

            taken = shortest(theirs, 2)
            error = worst(theirs(), exact)
            print(f"  MuJoCo at {1e3 * step:g} ms: {taken[1]:.3f} s, {taken[1] / own[1]:.1f} times, error {error:.1e}")


def rigid(twin: Twin, duration: float, *, sample_time: float = 1e-3, delay: float = 0.0, checked: bool = False) -> None:
    """Print the time of rigid DIDIM, under laws with a delay; and of `identify` with all checks."""
    loop = twin.loop()
    loop = replace(loop, controllers=tuple(replace(one, delay=delay) for one in loop.controllers))  # type: ignore[type-var]
    records, _ = recorded(loop, twin.records(duration, sample_time=sample_time), 0.03)
    taken = shortest(lambda: search_robot(loop, records), 3)
    fit = search_robot(loop, records)
    print(
        f"rigid DIDIM, {len(twin.robot)} joints, {duration:g} s at {1 / sample_time:g} Hz: "
        f"{taken[0]:.2f} s (processor {taken[1]:.2f} s), "
        f"{len(fit.parameters.names)} parameters, {fit.iterations} iterations",
        flush=True,
    )
    if checked:
        taken = shortest(lambda: identify(records, loop), 2)
        print(f"  with all checks: {taken[0]:.2f} s (processor {taken[1]:.2f} s)", flush=True)


def flexible(twin: Twin, duration: float, *, searched: bool) -> None:
    """Print the time of flexible DIDIM, from frequencies that are some 20 % off those of six joints, or looked for."""
    records, _ = recorded(twin.loop(), twin.records(duration, multisine=0.004), 0.02)
    near = (12.0, 14.0, 18.0, 24.0, 37.0, 37.0)
    given = None if searched else dict(zip(twin.robot.names, near, strict=True))
    taken = shortest(lambda: search_robot(twin.loop(), records, None, DIDIM(frequencies=given or {})), 2)
    found = search_robot(twin.loop(), records, None, DIDIM(frequencies=given or {}))
    print(
        f"flexible DIDIM, {len(twin.robot)} joints, {duration:g} s, modes {'looked for' if searched else 'given'}: "
        f"{taken[0]:.2f} s (processor {taken[1]:.2f} s), {len(found.parameters.names)} parameters, "
        f"{found.iterations} runs with derivatives, {[*found.springs.values()].count(None)} springs shown",
        flush=True,
    )


def twelve() -> Twin:
    """Return two arms of six joints on one base."""
    arm = six()
    links = [
        replace(link, name=f"{link.name} {side}", parent=-1 if link.parent < 0 else link.parent + first)
        for side, first in (("left", 0), ("right", len(arm.robot)))
        for link in arm.robot.links
    ]
    joints = [replace(one, name=f"{one.name} {side}") for side in ("left", "right") for one in arm.robot.joints]
    twice = (np.tile(values, 2) for values in (arm.home, arm.travel, arm.inertia, arm.bandwidth))
    return Twin(replace(arm.robot, links=tuple(links), joints=tuple(joints)), *twice)


def main() -> None:
    """Print it all."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.robots")
    parser.add_argument("--twelve", action="store_true", help="the time of twelve joints, alone")
    said = parser.parse_args()
    if not said.twelve:
        loops()
        for twin in (two(), six(), seven()):
            rigid(twin, 10.0)
    rigid(twelve(), 60.0, sample_time=2e-3, delay=5e-4, checked=True)
    if said.twelve:
        return
    flexible(six(True), 10.0, searched=False)
    for twin in (two((12.0, 18.0)), six(True), seven(flexible=True)):
        flexible(twin, 10.0, searched=True)


if __name__ == "__main__":
    main()
