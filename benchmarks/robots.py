"""How long robots take to simulate and to identify, beside MuJoCo's own stepping at its own error.

    python -m benchmarks.robots

The closed loop: 6 joints, 10 s at 1 kHz, rigid and flexible, and MuJoCo in steps of 1 ms to 0.05 ms, the errors of both
against jointid's own run at sixteen times the steps, which an adaptive integrator with the same events confirms
(`tests/simulation/test_robots.py`). Then DIDIM, and what it costs over joints and over the length of the record. Times
are the shortest of several turns, taken in turn; those of the processor are printed beside those of the clock, since
a machine may have other work.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.estimation.robots.didim import identify_rigid_robot
from jointid.estimation.robots.flexible import identify_flexible_robot
from jointid.simulation.robots import RobotNumbers, prepare_robot, rest, run_robot
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
        experiment, numbers = prepare_robot(loop, twin.records(10.0)), RobotNumbers.of(twin.robot)
        exact = run_robot(experiment, numbers, steps=16).torque
        own = shortest(lambda: run_robot(experiment, numbers))  # noqa: B023
        print(f"{name}, times of the processor: ours {own[1]:.3f} s, ", end="")
        print(f"error {worst(run_robot(experiment, numbers).torque, exact):.1e}")
        gains = np.array([[c.position_gain, c.derivative_gain] for c in loop.controllers])  # type: ignore[attr-defined]
        start = rest(experiment, numbers)[0]
        for step in STEPS:

            def theirs(step: float = step) -> FloatArray:
                return simulate_by_mujoco(twin.robot, gains, experiment.references, 1e-3, start, step)  # noqa: B023

            taken = shortest(theirs, 2)
            error = worst(theirs(), exact)
            print(f"  MuJoCo at {1e3 * step:g} ms: {taken[1]:.3f} s, {taken[1] / own[1]:.1f} times, error {error:.1e}")


def rigid(twin: Twin, duration: float) -> None:
    """Print the time of rigid DIDIM."""
    records, _ = recorded(twin.loop(), twin.records(duration), 0.03)
    taken = shortest(lambda: identify_rigid_robot(twin.loop(), records), 3)
    fit = identify_rigid_robot(twin.loop(), records)
    print(
        f"rigid DIDIM, {len(twin.robot)} joints, {duration:g} s: {taken[0]:.2f} s (processor {taken[1]:.2f} s), "
        f"{len(fit.names)} parameters, {fit.iterations} iterations",
        flush=True,
    )


def flexible(twin: Twin, duration: float, *, searched: bool) -> None:
    """Print the time of flexible DIDIM, from frequencies that are some 20 % off, or looked for."""
    records, _ = recorded(twin.loop(), twin.records(duration, multisine=0.004), 0.02)
    near = [12.0, 14.0, 18.0, 24.0, 37.0, 37.0] if len(twin.robot) == 6 else [15.0] * len(twin.robot)
    given = None if searched else dict(zip(twin.robot.names, near, strict=True))
    taken = shortest(lambda: identify_flexible_robot(twin.loop(), records, frequencies=given), 2)
    found = identify_flexible_robot(twin.loop(), records, frequencies=given)
    print(
        f"flexible DIDIM, {len(twin.robot)} joints, {duration:g} s, modes {'looked for' if searched else 'given'}: "
        f"{taken[0]:.2f} s (processor {taken[1]:.2f} s), {len(found.fit.names)} parameters, {found.evaluations} runs "
        f"with derivatives, {sum(spring.shown for spring in found.springs)} springs shown",
        flush=True,
    )


def main() -> None:
    """Print it all."""
    loops()
    for twin in (two(), six(), seven()):
        rigid(twin, 10.0)
    for duration in (5.0, 20.0, 40.0):
        rigid(six(), duration)
    flexible(two((12.0, 18.0)), 10.0, searched=False)
    flexible(six(True), 10.0, searched=False)
    flexible(six(True), 10.0, searched=True)


if __name__ == "__main__":
    main()
