"""Coverage of the stated margins: random flexible drives, identified from torque alone, against their true margins.

Each twin is a drive of another size under a loop that suits it, with a disturbance inside the loop. It is identified
from torque and reference, the margins of its loop and of the loop that is then proposed are stated, and set beside
those of the true joint under the same laws. A margin holds where the true one is no smaller.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.diagnostics.identify import identify
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Cascade, Controller
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.records.record import Record
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.synthesis import simulated_record
from jointid.tuning.margins import NAMES, joint_set
from jointid.tuning.tune import LoopMargins, tune

_ROUNDING = 1e-3  # of a margin: how exactly it is computed
_SHARES = (0.02, 0.10)  # of the torque's variation, that the disturbance makes of it


@dataclass(frozen=True, slots=True, eq=False)
class RandomDrive:
    """A random flexible drive under its loop, and its motion.

    Attributes:
        loop: of joint and controller. truth: the joint's parameters. mode: Hz, free-free.
        period: s. reference, known: (samples,) the motion, and the pulses that are injected.
        seed: of all of it. noise: standard deviation of the disturbance.
    """

    loop: ClosedLoop
    truth: dict[str, float]
    mode: float
    period: float
    reference: FloatArray
    known: FloatArray
    noise: float = 0.0

    def record(self, seed: int | None, truth: dict[str, float] | None = None) -> Record:
        """Return a record of torque and reference, with a disturbance of that seed, or none."""
        white = None
        if seed is not None:
            white = self.noise * np.random.default_rng([seed, 3]).standard_normal(self.reference.size)
        made = simulated_record(
            self.loop, self.reference, truth or self.truth, sample_time=self.period, injected=self.known,
            disturbance=white, name="twin",
        )  # fmt: skip
        return made.without("motor_position", "load_position")

    def identified(self, record: Record) -> Estimate:
        """Return what torque and reference say; the search begins at the mode's frequency, which saves time alone."""
        return identify(record, self.loop, DIDIM(frequency=self.mode), checks=False)


@dataclass(frozen=True, slots=True)
class MarginRun:
    """One twin: what was stated, and what is true.

    Attributes:
        seed: of the twin. mode: Hz.
        stated: margins by loop ("present", "proposed") and name, of the loops for which any could be stated.
        true: the same of the true joint. refused: why none was stated, if so.
    """

    seed: int
    mode: float
    stated: dict[str, tuple[float, ...]]
    true: dict[str, tuple[float, ...]]
    refused: str = ""

    def holds(self, loop: str, name: str) -> bool:
        """True if a margin is no smaller than stated."""
        at = NAMES.index(name)
        return self.true[loop][at] >= self.stated[loop][at] * (1 - _ROUNDING)


def judge(seed: int) -> MarginRun:
    """Identify one twin, and state the margins of its loop and of the proposed one."""
    drive = random_drive(seed)
    try:
        tuned = tune(drive.identified(drive.record(seed)))
    except MethodError as error:
        return MarginRun(seed, drive.mode, {}, {}, str(error))
    stated: dict[str, tuple[float, ...]] = {}
    true: dict[str, tuple[float, ...]] = {}
    loops: dict[str, LoopMargins | None] = {"present": tuned.present, "proposed": tuned.proposed}
    for name, loop in loops.items():
        if loop is not None and loop.worst.stable:
            stated[name] = tuple(getattr(loop.worst, one) for one in NAMES)
            true[name] = true_margins(drive, loop.controller)
    return MarginRun(seed, drive.mode, stated, true, "" if len(stated) == 2 else "; ".join(tuned.notes))


def true_margins(drive: RandomDrive, controller: Controller) -> tuple[float, ...]:
    """Return the margins of the true joint under a law."""
    law = controller.law(drive.period)
    return tuple(map(float, joint_set(drive.loop.joint, [drive.truth], law).margins(law)[0]))


def random_drive(seed: int) -> RandomDrive:
    """Return a random drive whose loop is stable: any size, modes of 5 to 200 Hz, damped by 0.5 to 8 %.

    Args:
        seed: of everything.
    """
    rng = np.random.default_rng([seed, 11])
    while True:
        drive = _drawn(rng, seed)
        law = drive.loop.controller.law(drive.period)
        if joint_set(drive.loop.joint, [drive.truth], law).margins(law)[0, -1] > 0.1:
            break
    clean, answer = drive.record(None), replace(drive, noise=1e-3 * _size(drive)).record(seed)
    assert clean.torque is not None and answer.torque is not None
    change = float(np.std(answer.torque.values - clean.torque.values))
    share = math.exp(rng.uniform(math.log(_SHARES[0]), math.log(_SHARES[1])))
    return replace(drive, noise=1e-3 * _size(drive) * share * float(np.std(clean.torque.values)) / change)


def _size(drive: RandomDrive) -> float:
    return drive.truth["motor_inertia"] * float(np.ptp(drive.reference)) * drive.mode**2


def _drawn(rng: np.random.Generator, seed: int) -> RandomDrive:
    inertia = 10 ** rng.uniform(-4, 2)
    mode = math.exp(rng.uniform(math.log(5), math.log(200)))
    period = 1 / math.exp(rng.uniform(math.log(15 * mode), math.log(60 * mode)))
    swing, pace = 10 ** rng.uniform(-1, 1), 30.0 / mode
    speeds = (0.21 * swing / pace, 0.415 * swing / pace, 0.625 * swing / pace)
    force = inertia * swing / pace**2
    reference = trapezoids(speeds, 4.15 * swing / pace**2, swing, period, duration=min(24.0 * pace, 30_000 * period))
    known = pulses(reference.size, period, height=7.0 * force, width=0.02 * pace, every=0.4 * pace, seed=seed)
    share, ratio = rng.uniform(0.2, 0.8), math.exp(rng.uniform(math.log(0.005), math.log(0.08)))
    motor, load, rate = (1 - share) * inertia, share * inertia, 2 * math.pi * mode
    reduced = motor * load / inertia
    level = rng.uniform(0.5, 1.5, 4)
    truth = {
        "motor_inertia": motor,
        "motor_viscous": level[0] * 0.95 * inertia / pace,
        "motor_coulomb": level[1] * 0.5 * force,
        "stiffness": reduced * rate**2,
        "damping": 2 * ratio * reduced * rate,
        "load_inertia": load,
        "load_viscous": level[2] * 0.95 * inertia / pace,
        "load_coulomb": level[3] * 0.5 * force,
        "offset": rng.uniform(-0.2, 0.2) * force,
    }
    controller = Cascade(
        position_gain=rate * rng.uniform(0.1, 0.4),
        velocity_gain=inertia * rate * rng.uniform(0.2, 0.6),
        integral_gain=rate * rng.uniform(0.01, 0.05) * (rng.random() < 0.3),
        delay=period * float(rng.choice([0.0, 0.5, 1.0])),
        velocity_filter=(0.5, 0.5) if rng.random() < 0.5 else (1.0,),
    )
    loop = ClosedLoop(FlexibleJoint(kind="revolute"), controller)
    return RandomDrive(loop, {name: float(value) for name, value in truth.items()}, mode, period, reference, known)
