"""Plants, laws and controllers in one table, against the one slow reference (`reference`)."""

from dataclasses import replace

import numpy as np
import pytest

from jointid.models.controllers import numbers_of, with_numbers
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.loop_input import LoopInput, prepare, to_log
from jointid.simulation.plant import Numbers
from jointid.simulation.simulate import Outcome, Simulation
from jointid.simulation.start import Initial
from jointid.simulation.synthesis import simulate
from tests.plants import LAWS, PIECES, prismatic, rigid, rotary, with_law
from tests.simulation.reference import of_loop

_PERIODS = 100

WAYS: dict[str, dict[str, float]] = {
    "plain": {}, "late by a fraction": {"delay": 0.37}, "late by periods": {"delay": 2.4}, "limited": {"limit": 0.3},
    "limited, with an integral": {"limit": 0.3, "integral_gain": 5.0, "delay": 0.37},
}  # fmt: skip
"""Numbers of the controller: delays in periods, limits in the torque's peak."""


def window(record: Record) -> Record:
    """Return a part of a record in which the reference turns round, after a rest; with a push."""
    moved = np.diff(record.reference.values)
    turns = int(np.flatnonzero(moved[1:] * moved[:-1] < 0.0)[0]) + 1
    at = turns + np.concatenate([np.arange(-_PERIODS // 3, 0), np.zeros(_PERIODS // 3, int), np.arange(_PERIODS // 3)])
    return record.with_channels({name: replace(one, values=one.values[at]) for name, one in record.items()})


def controlled(loop: ClosedLoop, record: Record, values: dict[str, float], way: str) -> ClosedLoop:
    """Return the loop with other numbers of its controller."""
    experiment, own = prepare(loop, record), dict(WAYS[way])
    peak = float(np.max(np.abs(simulate(loop, experiment, values).torque)))
    size = {"delay": experiment.axis.law.period, "limit": peak / numbers_of(loop.controller)["gain"]}
    return replace(loop, controller=with_numbers(loop.controller, {n: x * size.get(n, 1.0) for n, x in own.items()}))


def errors(
    loop: ClosedLoop, experiment: LoopInput, values: dict[str, float], initial: Initial | None, *steps: int | None
) -> tuple[list[float], Simulation, int]:
    """Return errors of torque or positions beside the reference by steps; the last run, and the reference's events."""
    command, q, _, events = of_loop(experiment, Numbers.of_joint(loop.joint, values), initial)
    torque, worst = to_log(experiment.axis, command[0] + experiment.axis.shown), []
    travel = np.ptp(q[:, 0]) + np.max(np.abs(q[:, 0] - q[:, -1]))
    for taken in steps:
        found = simulate(loop, experiment, values, initial, steps=taken)
        assert found.outcome is Outcome.FINISHED
        seen = [(found.torque, torque, np.max(np.abs(torque))), (found.motor_position, q[:, 0], travel)]
        seen += [] if found.load_position is None else [(found.load_position, q[:, 1], travel)]
        worst.append(max(float(np.max(np.abs(one - other))) / size for one, other, size in seen))
    return worst, found, events


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(2, 9))])
def test_joints_of_straight_lines_are_exact(seed: int, way: str) -> None:
    """Rigid and flexible, of friction that differs by the direction; they stick, slide and turn round."""
    case = (prismatic, rotary)[seed % 2](seed)
    record = window(case.clean)
    for made, law in ((case, "asymmetric"), (rigid(case), "symmetric")):
        loop, values = with_law(made, law)
        loop = controlled(loop, record, values, way)
        speed = 0.1 * float(np.max(np.abs(np.diff(record.reference.values)))) / record.reference.sample_time  # type: ignore[union-attr]
        (error,), found, events = errors(loop, prepare(loop, record), values, Initial(velocity=speed), None)
        assert error <= 1e-9
        assert found.events == events
        assert found.at_limit > 0.01 or "limited" not in way


ALONE = [("prismatic", (law,)) for law in (*LAWS, *PIECES, "balanced")]
QUICK = [
    *((*row, "plain") for row in ALONE if "presliding" not in row[1][0]),
    ("rotary", ("stribeck", "link"), "plain"),
    ("rotary", ("cubic",), "late by a fraction"),
    ("rigid prismatic", ("drifting", "ripple"), "limited"),
    ("rigid prismatic", ("asymmetric-load-dependent",), "limited, with an integral"),
    ("prismatic", ("cubic", "load ripple"), "limited"),
    ("prismatic", ("backlash", "ripple"), "plain"),
    ("prismatic", ("backlash-cubic-hysteretic",), "plain"),
    ("prismatic", ("asymmetric-stribeck", "two-piece-elastic-load"), "plain"),
    ("prismatic", ("stribeck-drifting-load-dependent", "hysteretic"), "plain"),
]
SLOW = [
    *((*row, "late by periods") for row in ALONE),
    *((*row, "plain") for row in ALONE if "presliding" in row[1][0]),
    *(("prismatic", (f"asymmetric-{law}",), "plain") for law in ("stribeck", "load-dependent")),
    ("rigid rotary", ("stribeck", "link"), "late by a fraction"),
    ("prismatic", ("two-piece",), "limited, with an integral"),
]


@pytest.mark.parametrize(
    ("drive", "laws", "way"), [*QUICK, *(pytest.param(*row, marks=pytest.mark.slow) for row in SLOW)]
)
def test_other_laws_alone_and_combined_are_as_near_as_is_said(drive: str, laws: tuple[str, ...], way: str) -> None:
    """Some 1e-5 of the torque's peak in steps as they are; half of them leave a sixteenth, or the reference's error."""
    case = (rotary if "rotary" in drive else prismatic)(1)
    case = rigid(case) if "rigid" in drive else case
    loop, values = with_law(case, *laws)
    record = window(case.clean)
    loop = controlled(loop, record, values, way)
    (usual, coarse, fine), found, _ = errors(loop, prepare(loop, record), values, None, None, 2, 4)
    bends = "load-dependent" in laws[0]  # where the torque goes through nothing, which no step ends at
    assert usual <= 3e-5
    assert fine <= (1e-6 if bends else 5e-9 if loop.joint.straight else max(coarse / 2.0**3.5, 1e-9))
    assert found.events > 0
    assert found.at_limit > 0.01 or "limited" not in way
