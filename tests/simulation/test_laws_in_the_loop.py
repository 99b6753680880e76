"""Joints under named laws: against the law written out around a drive that matrix exponentials, or DOP853, move."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline
from scipy.linalg import expm

from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import PD, PID, REFERENCE, Cascade, FirstOrder, Notch, SecondOrder, shift_start
from jointid.models.joints import ClosedLoop, FlexibleJoint, Joint, RigidJoint
from jointid.records.record import Channel, Injection, Record, Timing
from jointid.simulation.closed_loop import Initial, Outcome, simulate
from jointid.simulation.excitation import trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from tests.estimates import identify
from tests.models.written_out import Sample, begun
from tests.simulation.oracle import Plant, _Joint

FAST, LOG = 125e-6, 2e-3
NOTCHES = (SecondOrder(400.0), Notch(80.0, 20.0, 0.1))
P_PI = Cascade(
    position_gain=60.0, velocity_gain=6e3, integral_gain=30.0, velocity_feedforward=0.9,
    reference_delay=1.1e-3,
    acceleration_feedforward=60.0, viscous_feedforward=90.0, coulomb_feedforward=10.0, constant_feedforward=-1.0,
    velocity_filter=FirstOrder(0.4e-3), torque_filters=NOTCHES, period=FAST,
    position_period=1e-3, position_offset=0.5e-3, delay=1.4 * FAST, interpolation="cubic",
)  # fmt: skip
LAWS: dict[str, Cascade | PD] = {
    "P-PI": P_PI,
    "P-PI, held command, on the grid": replace(P_PI, interpolation="hold", delay=2 * FAST, position_offset=0.0),
    "P-PI, limits, hold": replace(P_PI, limit=60.0, velocity_limit=0.11, interpolation="linear"),
    "P-PI, limits, track": replace(
        P_PI, limit=60.0, velocity_limit=0.11, anti_windup="track", delay=0.0, torque_filters=(),
        acceleration_feedforward=3.0,
    ),
    "P-P": replace(P_PI, integral_gain=0.0),
    "P-P, averaged": replace(P_PI, integral_gain=0.0, interpolation="hold", reference_average=42.3 * FAST),
    "PID": PID(
        position_gain=3e5, derivative_gain=6e3, integral_gain=3e6, period=FAST, delay=0.7 * FAST, limit=80.0,
        velocity_filter=(0.5, 0.5),
        torque_filters=NOTCHES, interpolation="cubic", acceleration_feedforward=0.6,
    ),  # of 60 kg the last bit of the reference, over the square of the period, would be 1e-8 N
    "PD": PD(position_gain=3e5, derivative_gain=6e3, period=FAST, velocity_filter=SecondOrder(800.0),
    interpolation="linear"),
}  # fmt: skip
RIGID = {"inertia": 95.0, "viscous": 207.0, "coulomb": 20.0, "offset": -3.2}
FLEXIBLE = {
    "motor_inertia": 70.2, "motor_viscous": 92.0, "motor_coulomb": 10.0, "stiffness": 8e5, "damping": 126.0,
    "load_inertia": 34.8, "load_viscous": 110.0, "load_coulomb": 10.4, "offset": -3.16,
}  # fmt: skip


def plant(values: dict[str, float]) -> Plant:
    """The oracle's plant of these values."""
    if "inertia" in values:
        viscous, coulomb = values["viscous"], values["coulomb"]
        return Plant(values["inertia"], (viscous, viscous), (coulomb, coulomb), values["offset"])
    pairs = [
        (values[name], values[name]) for name in ("motor_viscous", "motor_coulomb", "load_viscous", "load_coulomb")
    ]
    return Plant(
        values["motor_inertia"], pairs[0], pairs[1], values["offset"], values["load_inertia"], pairs[2], pairs[3],
        0.0, values["stiffness"], values["damping"],
    )  # fmt: skip


class Smooth:
    """A drive without Coulomb friction, moved by the exponential of its matrix; one for each length of time."""

    def __init__(self, plant: Plant, start: float) -> None:
        rigid = plant.inertia2 is None
        K, F, M1, M2 = plant.stiffness, plant.damping, plant.inertia1, plant.inertia2 or 1.0
        forces = np.zeros((2, 5))  # by q1, v1, q2, v2, and the torque less the offset
        forces[0] = [-K, -F - plant.fv1[0], K, F, 1.0]
        forces[1] = [0.0] * 5 if rigid else [K, F, -K, -F - plant.fv2[0], 0.0]
        self.A = np.zeros((5, 5))
        self.A[0, 1] = self.A[2, 3] = 1.0
        self.A[1], self.A[3] = forces[0] / M1, forces[1] / M2
        self.x = np.array([start, 0.0, start, 0.0, 0.0])
        self.offset, self.maps = plant.offset, dict[float, np.ndarray]()

    def move(self, begin: float, seconds: float, torque: float) -> None:
        self.x[4] = torque - self.offset
        self.x = self.maps.setdefault(seconds, expm(self.A * seconds) if seconds not in self.maps else self.A) @ self.x

    @property
    def q(self) -> float:
        return float(self.x[0])


class Rubbing:
    """A drive with Coulomb friction, by the oracle's integrator."""

    def __init__(self, plant: Plant, start: float) -> None:
        x0 = np.zeros(2 if plant.inertia2 is None else 4)
        x0[::2] = start
        self.made, self.events = _Joint(plant, x0, FAST, 1e-12, 1e-13, None), []  # type: ignore[var-annotated]

    def move(self, begin: float, seconds: float, torque: float) -> None:
        self.made.begin(begin, torque, self.events)
        self.made.advance(begin, seconds, torque, self.events)

    @property
    def q(self) -> float:
        return float(self.made.q[0])


@dataclass(frozen=True)
class Driven:
    """What the loops here are driven with: a command that is slower than the log, and a push before the limit."""

    command: float
    samples: int

    @property
    def values(self) -> np.ndarray:
        return trapezoids((0.05, 0.1), 0.6, 0.01, self.command, rest=0.02)[: self.samples]

    @property
    def pushed(self) -> np.ndarray:
        return 25.0 * (np.arange(round(self.samples * self.command / FAST)) % 700 > 550)

    def record(self) -> Record:
        torque = np.zeros(round(self.samples * self.command / LOG))
        return Record(
            torque=Channel(torque, "N", LOG, Timing.HELD),
            reference=Channel(self.values, "m", self.command),
            injected=Injection(Channel(self.pushed, "N", FAST), "before_limit"),  # type: ignore[arg-type]
        )

    def filled(self, interpolation: str, average: float = 0.0) -> np.ndarray:
        """The reference, period by period."""
        if average:  # of each period the mean of the last ones, of the first of which only a part counts
            plain, n = self.filled(interpolation), average / FAST
            begun = np.concatenate([plain[0] + (plain[1] - plain[0]) * np.arange(-math.ceil(n), 0), plain])
            weights = [min(1.0, n - j) / n for j in range(math.ceil(n))]
            return sum(w * begun[math.ceil(n) - j :][: plain.size] for j, w in enumerate(weights))  # type: ignore[return-value]
        values, repeat = self.values, round(self.command / FAST)
        k = np.arange(values.size)
        at = np.minimum(np.arange(values.size * repeat) / repeat, values.size - 1)
        if interpolation == "cubic":
            return np.asarray(CubicHermiteSpline(k, values, np.gradient(values))(at))
        return np.interp(at, k, values) if interpolation == "linear" else values[at.astype(int)]


def expected(
    law: Any, drive: Smooth | Rubbing, driven: Driven, r: np.ndarray, torque: float | None
) -> tuple[np.ndarray, np.ndarray]:
    """The torque and the position at the log's instants, of a reference period by period."""
    direction = np.sign(np.diff(r, prepend=r[0]))
    direction[0] = direction[1]
    samples = [Sample(a, 0.0, b, c) for a, b, c in zip(r, direction, driven.pushed, strict=True)]
    written, out = begun(law, FAST, samples[0], (r[1] - r[0]) / FAST, r[0], 0.0, torque)
    before = min(max(out, -law.limit * law.gain), law.limit * law.gain)
    whole = math.floor(law.delay / FAST + 1e-9)
    part = law.delay / FAST - whole
    part = 0.0 if part < 1e-9 else part
    acts, rows = [before] * (whole + 1), []
    for k, sample in enumerate(samples):
        acting = written(sample, drive.q)
        rows.append((acting, drive.q))
        acts.append(acting)
        if part:
            drive.move(k * FAST, part * FAST, acts[k])
        drive.move((k + part) * FAST, (1 - part) * FAST, acts[k + 1])
    found = np.array(rows)[:: round(LOG / FAST)]
    return found[:, 0], found[:, 1]


def check(
    law: Any, joint: Joint, values: dict[str, float], driven: Driven, torque: float | None, share: float
) -> float:
    """Assert that the loop does what is expected; return how often the law is at its limit."""
    loop = ClosedLoop(joint, law)
    experiment = prepare(loop, driven.record())
    # Its second difference brings out the last bit, so both have the very same.
    reference = experiment.inputs[:, REFERENCE]
    assert np.max(np.abs(reference - driven.filled(law.interpolation, law.reference_average))) <= 1e-15
    found = simulate(loop, experiment, values, Initial(torque=torque))
    rubs = any(size and "coulomb" in name for name, size in values.items())
    drive = (Rubbing if rubs else Smooth)(plant(values), float(driven.values[0]))
    wanted, position = expected(law, drive, driven, reference, torque)
    assert found.outcome is Outcome.FINISHED
    assert found.torque.size == wanted.size
    assert np.max(np.abs(found.torque - wanted)) <= share * np.max(np.abs(wanted))
    assert np.max(np.abs(found.motor_position - position)) <= share * np.ptp(position)
    return found.at_limit


@pytest.mark.parametrize(
    "joint",
    [pytest.param(RigidJoint("prismatic"), marks=pytest.mark.slow), FlexibleJoint("prismatic")],
    ids=["rigid", "flexible"],
)
@pytest.mark.parametrize("name", LAWS)
def test_a_loop_without_coulomb_friction_is_its_matrix_exponentials(name: str, joint: Joint) -> None:
    law, values = LAWS[name], RIGID if joint.model == "rigid" else FLEXIBLE
    smooth = {key: 0.0 if "coulomb" in key else value for key, value in values.items()}
    torque = 12.0 if law.law(FAST).integrates else None
    limited = check(law, joint, smooth, Driven(4e-3, 100), torque, 1e-9)
    assert (limited > 0.02) == (law.limit < math.inf)


@pytest.mark.slow
@pytest.mark.parametrize("joint", [RigidJoint("prismatic"), FlexibleJoint("prismatic")], ids=["rigid", "flexible"])
@pytest.mark.parametrize("name", ["P-PI, limits, hold", "P-PI, limits, track"])
def test_a_loop_that_sticks_is_the_event_driven_one(name: str, joint: Joint) -> None:
    check(LAWS[name], joint, RIGID if joint.model == "rigid" else FLEXIBLE, Driven(2e-3, 130), None, 1e-9)


def test_a_fast_loop_with_a_slow_position_gain_has_not_gone_far() -> None:
    """Its gain within a period is nearly all the velocity's: 16000 / s beside 10 / s."""
    reference = trapezoids((0.05, 0.1), 1.0, 0.05, 1e-3, rest=0.15)
    loop = ClosedLoop(RigidJoint("prismatic"), Cascade(position_gain=10.0, velocity_gain=3e3, period=62.5e-6))
    run = simulate(loop, prepare(loop, Record(reference=Channel(reference, "m", 1e-3))), RIGID)
    assert run.outcome is Outcome.FINISHED
    assert np.ptp(run.motor_position) > 0.9 * np.ptp(reference)


T = 1e-3
SLOW = Cascade(
    position_gain=60.0, velocity_gain=6e3, position_period=4 * T, position_offset=2 * T, velocity_feedforward=0.5
)
AT_REST = np.concatenate([np.zeros(12), trapezoids((0.1, 0.2), 2.0, 0.1, T, duration=2.0)])


def after(cut: float, law: Cascade = SLOW) -> Record:
    """What remains of a log from so many samples on, while nothing moves: as if its first refresh had been there."""
    loop = ClosedLoop(RigidJoint("prismatic"), law)
    whole = Record(reference=Channel(AT_REST, "m", T))
    torque = simulate(loop, prepare(loop, whole), RIGID | {"offset": 0.0}).torque
    first = math.ceil(cut)
    kept = (Channel(AT_REST[first:], "m", T), Channel(torque[first:], "N", T, Timing.HELD))
    return Record(reference=kept[0], torque=kept[1], begin=cut * T)


@pytest.mark.parametrize("cut", [0, 1, 3, 6])
def test_a_position_loop_keeps_its_instants_where_a_log_begins_later(cut: int) -> None:
    """Simulated, differentiated and identified: the law of the whole log, whatever was cut off."""
    loop, record, values = ClosedLoop(RigidJoint("prismatic"), SLOW), after(cut), RIGID | {"offset": 0.0}
    assert record.torque is not None
    run = simulate(loop, prepare(loop, record), values)
    size = float(np.max(np.abs(record.torque.values)))
    np.testing.assert_allclose(run.torque, record.torque.values, atol=1e-9 * size)
    missed = simulate(loop, prepare(loop, replace(record, begin=record.begin + T)), values)
    assert np.max(np.abs(missed.torque - record.torque.values)) > 0.01 * size

    slope = simulate_sensitivities(loop, prepare(loop, record), values, ("position_gain",)).torque[:, 0]
    low, high = (after(cut, replace(SLOW, position_gain=SLOW.position_gain + by)).torque for by in (-1e-3, 1e-3))
    assert low is not None
    assert high is not None
    difference = (high.values - low.values) / 2e-3
    np.testing.assert_allclose(slope, difference, atol=1e-4 * np.max(np.abs(difference)))

    wrong = ClosedLoop(RigidJoint("prismatic"), replace(SLOW, position_gain=1.02 * SLOW.position_gain))
    found = identify(record, wrong, DIDIM(free=("position_gain",)))
    assert found["position_gain"].value == pytest.approx(SLOW.position_gain, rel=1e-5)
    assert found["inertia"].value == pytest.approx(RIGID["inertia"], rel=1e-5)


def test_a_record_that_begins_between_two_samples_of_the_file_takes_the_next_instant() -> None:
    """Evaluated at 2, 6, ... ms after the file's first sample; the record's instants are at 2.5, 3.5, ... ms."""
    assert shift_start(SLOW, 2.5 * T) == replace(SLOW, position_offset=3.5 * T)
    for off_grid, first in ((3.5, 4), (3.001, 3), (3.1, 4), (0.0, 0)):
        law, on_grid = (replace(SLOW, position_offset=at * T).law(T) for at in (off_grid, first))
        np.testing.assert_array_equal(law.A, on_grid.A)
        np.testing.assert_array_equal(law.B, on_grid.B)


@pytest.mark.parametrize("later", [0, 1, 2, 3, 7])
def test_a_learned_offset_is_counted_from_the_file(later: int) -> None:
    """What a record that begins later shows, and what its file is told, lead to each other, on any grid."""
    slow = replace(SLOW, period=4 * T, position_period=16 * T, position_offset=8 * T)
    for learned in (SLOW, slow):
        declared = shift_start(learned, -later * T)
        assert isinstance(declared, Cascade)
        cycle = learned.position_period or T
        assert declared.position_offset == pytest.approx((learned.position_offset + later * T) % cycle, abs=1e-15)
        assert shift_start(declared, later * T) == learned
    assert shift_start(PD(position_gain=1.0, derivative_gain=1.0), later * T) == PD(
        position_gain=1.0, derivative_gain=1.0
    )
