"""Actuator joints under the law of an MIT-mode drive, made by MuJoCo: what is elastic, loose or late, or wrong.

Three families at the joint's side: quasi-direct drives without a spring, strain-wave drives with one, hobby servos with
play. Each drive computes ``tau = kp (q_des - q) + kd (dq_des - dq) + tau_ff`` at 1 to 20 kHz, and its torque acts up to
10 ms later, which nobody declares: the delay is identified. The log has 100 Hz to 1 kHz, a torque of 12 bits with
noise, and a position of 16 bits. `judge` identifies the joint as flexible, from the logged torque, and from the motor
position beside it where the torque is a command.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.diagnostics.faults.record import explain_on_position
from jointid.diagnostics.find_causes import explain_failure
from jointid.estimation.methods.didim import DIDIM
from jointid.models.controllers import PD
from jointid.models.springs import find_spring
from jointid.records.record import Channel, Injection, InjectionPoint, Tap, Timing
from studies.seeds import judge_seeds

KINDS = ("quasi-direct", "strain-wave", "servo")
FAULTS = ("none", "kp", "velocity filter", "kd unit", "torque unit")
RIGHT = {  # what a fault is called, first or among what the loop cannot tell from it
    "kp": {"position_gain"}, "velocity filter": {"velocity_filter"}, "kd unit": {"derivative_gain"},
    "torque unit": {"log_gain", "torque_scale", "law_gain", "gain", "gear_side"},
}  # fmt: skip
SAID = {
    "kp": ("position gain",), "velocity filter": ("velocity filter",), "kd unit": ("derivative gain",),
    "torque unit": ("the torque is",),
}  # fmt: skip
_STEP = 2.5e-5  # s of MuJoCo, at most
# As hard as the step allows, so that what sticks does not creep.
_HARD = 'solreffriction="-1 -100000" solimpfriction="0.9999 0.9999 0.001 0.5 2"'
_DURATION, _BEGIN = 4.0, 0.5  # s of a log, and until its test has grown to its size
_SINES = 24
_BITS, _ENCODER = 12, 2 * math.pi / 2**16
_IN_TIME, _MOVED = 3e-4, 2.0  # s: a delay that is right; standard errors
_TURNS = {"kd unit": 180 / math.pi, "torque unit": 9.0}  # degrees for radians; the motor's torque for the joint's


@dataclass(frozen=True)
class Actuator:
    """An actuator and its drive at the joint's side, in SI units.

    Attributes:
        kind: of `KINDS`.
        truth: of the joint, and the delay, s.
        gains: kp and kd.
        period, log: of drive and log, s.
        noise: of the logged torque, as a share of its scatter.
        bandwidth: of the torque that is added, Hz.
        measured: whether the log has the torque that acts.
        rng: for the rest.
    """

    kind: str
    truth: dict[str, float]
    gains: tuple[float, float]
    period: float
    log: float
    noise: float
    bandwidth: float
    measured: bool
    rng: np.random.Generator


def draw(seed: int, kind: str) -> Actuator:
    """Return a random actuator whose loop is well damped with its delay."""
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    period = 1 / float(rng.choice([1e3, 2e3, 5e3, 1e4, 2e4]))
    log = max(1 / float(rng.choice([100, 200, 250, 500, 1000])), period)
    step = min(period, _STEP)
    delay = step * round(rng.uniform(0, 0.01) / step)
    noise = rng.uniform(0.01, 0.05)
    while True:
        truth, gains, bandwidth = _draw_joint(rng, kind)
        if _decay(truth, gains, delay + period) > 1.5:
            break
    truth |= {"delay": delay}
    bandwidth = min(bandwidth, 0.4 / log)
    return Actuator(kind, truth, gains, period, log, noise, bandwidth, bool(rng.integers(2)), rng)


def _draw_joint(rng: np.random.Generator, kind: str) -> tuple[dict[str, float], tuple[float, float], float]:
    def spread(low: float, high: float) -> float:
        return float(low * (high / low) ** rng.uniform())

    if kind == "quasi-direct":
        rotor = spread(5e-5, 2e-4) * rng.uniform(6, 10) ** 2
        inertia = rotor + spread(0.005, 0.1)
        truth = {"inertia": inertia, "viscous": spread(0.02, 0.2), "coulomb": spread(0.1, 0.6)}
        bandwidth, whole = 40.0, inertia
    else:
        if kind == "strain-wave":
            motor = spread(2e-5, 1e-4) * rng.uniform(50, 160) ** 2
            load, mode, damped = motor * spread(0.3, 3.0), spread(12, 50), spread(0.01, 0.04)
            friction, gap = (spread(3, 12) * motor, spread(1, 4) * motor, spread(8, 25) * motor), 0.0
        else:
            motor = spread(0.002, 0.01)
            load, mode, damped = motor * spread(0.3, 1.5), spread(20, 45), spread(0.12, 0.3)
            friction, gap = (spread(5, 12) * motor, spread(1, 3) * motor, spread(10, 20) * motor), rng.uniform(0.5, 2.0)
        reduced = motor * load / (motor + load)
        stiffness = reduced * (2 * math.pi * mode) ** 2
        truth = {
            "motor_inertia": motor, "motor_viscous": friction[0], "motor_coulomb": friction[2], "stiffness": stiffness,
            "damping": 2 * damped * math.sqrt(stiffness * reduced), "load_inertia": load,
            "load_viscous": friction[1] * load / motor, "load_coulomb": 0.15 * friction[2] * load / motor,
            "offset": 0.0,
        }  # fmt: skip
        truth |= {"gap": math.radians(gap)} if gap else {}
        bandwidth, whole = 2 * mode, motor + load
    natural, damping = 2 * math.pi * spread(1.5, 8), rng.uniform(0.3, 1.0)
    return truth, (whole * natural**2, 2 * damping * natural * whole), bandwidth


def _decay(truth: dict[str, float], gains: tuple[float, float], late: float) -> float:
    """Return how fast the slowest motion of the loop decays, 1/s, without Coulomb friction and play."""
    kp, kd = gains
    flexible = "stiffness" in truth
    if flexible:
        m1, m2 = truth["motor_inertia"], truth["load_inertia"]
        k, c, b1, b2 = (truth[name] for name in ("stiffness", "damping", "motor_viscous", "load_viscous"))
        mass = np.polysub(np.polymul([m1, b1 + c, k], [m2, b2 + c, k]), np.polymul([c, k], [c, k]))
        load = np.array([m2, b2 + c, k])
    else:
        mass, load = np.array([truth["inertia"], truth["viscous"], 0.0]), np.array([1.0])
    ahead: FloatArray = np.ones(1)
    behind: FloatArray = np.ones(1)
    for _ in range(3):  # a product of Pade's approximations of the second order
        part = late / 3
        ahead = np.asarray(np.polymul(ahead, [part**2 / 12, -part / 2, 1.0]), dtype=np.float64)
        behind = np.asarray(np.polymul(behind, [part**2 / 12, part / 2, 1.0]), dtype=np.float64)
    whole = np.polyadd(np.polymul(mass, behind), np.polymul(np.polymul([kd, kp], load), ahead))
    return -float(np.max(np.roots(whole).real))


def _multisine(rng: np.random.Generator, size: float, lowest: float, highest: float, time: FloatArray) -> FloatArray:
    frequencies = np.geomspace(lowest, highest, _SINES)
    wave = np.sin(2 * math.pi * frequencies * time[:, None] + rng.uniform(0, 2 * math.pi, _SINES)).sum(axis=1)
    return np.asarray(np.minimum(time / _BEGIN, 1.0) * size * wave / np.abs(wave).max())


def _model(truth: dict[str, float], step: float) -> Any:
    """Return the joint in MuJoCo: one body, or motor and load with a tendon as the spring between."""
    import mujoco  # type: ignore[import-untyped]

    def body(name: str, prefix: str) -> str:
        inertia, viscous, coulomb = (truth[prefix + one] for one in ("inertia", "viscous", "coulomb"))
        return (
            f'<body name="{name}"><inertial mass="1" pos="0 0 0" diaginertia="{inertia!r} {inertia!r} {inertia!r}"/>'
            f'<joint name="{name}" axis="0 1 0" damping="{viscous!r}" frictionloss="{coulomb!r}" {_HARD}/></body>'
        )

    bodies, spring = body("motor", "" if "inertia" in truth else "motor_"), ""
    if "stiffness" in truth:
        gap = truth.get("gap", 0.0)
        bodies += body("load", "load_")
        spring = (
            f'<tendon><fixed stiffness="{truth["stiffness"]!r}" damping="{truth["damping"]!r}" '
            f'springlength="{-gap / 2!r} {gap / 2!r}"><joint joint="load" coef="1"/><joint joint="motor" coef="-1"/>'
            "</fixed></tendon>"
        )
    return mujoco.MjModel.from_xml_string(
        f'<mujoco><compiler angle="radian"/><option gravity="0 0 0" timestep="{step!r}" integrator="implicitfast"/>'
        f"<worldbody>{bodies}</worldbody>{spring}"
        '<actuator><motor joint="motor"/></actuator></mujoco>'
    )


@dataclass(frozen=True)
class Logged:
    """A record, its loop as declared, and the actuator."""

    record: ji.Record
    loop: ji.ClosedLoop
    actuator: Actuator


def log(seed: int, kind: str, fault: str = "none") -> Logged:
    """Simulate an actuator whose drive differs from what is declared by a fault, and return its log.

    The drive holds what it is told at the instants of the log. A gain kp is 20 % larger or smaller than declared; the
    velocity passes a filter of the first order of 1.6 to 8 ms; kd is declared in N m s/deg, or the torque is logged
    before a gear of 9:1.
    """
    import mujoco

    one = draw(seed, kind)
    rng, truth, period = one.rng, one.truth, one.period
    step = min(period, _STEP)
    compiled = _model(truth, step)
    data = mujoco.MjData(compiled)
    (kp, kd), inner, outer = one.gains, round(period / step), round(one.log / period)
    time: FloatArray = one.log * np.arange(round(_DURATION / one.log), dtype=np.float64)
    wanted = _multisine(rng, rng.uniform(0.3, 0.6), 0.2, 2.0, time)
    speed = np.gradient(wanted, one.log)
    whole = truth["inertia"] if "inertia" in truth else truth["motor_inertia"] + truth["load_inertia"]
    moving = float(np.std(np.gradient(speed, one.log))) * whole + truth.get("coulomb", truth.get("motor_coulomb", 0.0))
    added = _multisine(rng, 3.0 * moving, 1.0, one.bandwidth, time)
    off = np.random.default_rng([seed, KINDS.index(kind), 7])
    factor, slow = float(off.choice([0.8, 1.2])), float(1 / (2 * math.pi * off.uniform(20, 100)))
    runs_kp = kp * factor if fault == "kp" else kp
    alpha = period / (period + slow) if fault == "velocity filter" else 1.0
    late = round(truth["delay"] / step)
    waiting = [0.0] * (late + 1)  # torques of the steps to come
    torque, position, acting = np.empty_like(time), np.empty_like(time), np.empty_like(time)
    before, velocity, tick, gap = 0.0, 0.0, 0, truth.get("gap", 0.0)
    for k in range(time.size):
        for part in range(outer):
            q = float(data.qpos[0])
            velocity += alpha * ((q - before) / period - velocity)
            before = q
            command = runs_kp * (wanted[k] - q) + kd * (speed[k] - velocity) + added[k]
            if part == 0:
                position[k], torque[k] = q, command
            for piece in range(inner):
                waiting[tick % (late + 1)] = command
                data.ctrl[0] = waiting[(tick + 1) % (late + 1)]
                if part == piece == 0:
                    acting[k] = data.ctrl[0]
                tick += 1
                if gap:  # nothing damps within the play, and a tendon's damper acts everywhere
                    apart = abs(data.qpos[1] - data.qpos[0])
                    compiled.tendon_damping[0] = truth["damping"] if apart > gap / 2 else 0.0
                mujoco.mj_step(compiled, data)
    seen = acting if one.measured else torque
    size = float(np.std(seen))
    bit = 2.0 * 1.5 * float(np.abs(seen).max()) / 2**_BITS
    seen = np.round((seen + one.noise * size * rng.standard_normal(seen.size)) / bit) * bit
    seen = seen / (_TURNS[fault] if fault == "torque unit" else 1.0)
    said_kd = kd * (_TURNS[fault] if fault == "kd unit" else 1.0)

    def channel(values: FloatArray, unit: str, timing: Timing = Timing.HELD) -> Channel:
        return Channel(values, unit, one.log, timing)

    record = ji.Record(
        torque=channel(seen, "N m"),
        tap=Tap.MEASURED if one.measured else Tap.COMMAND,
        reference=channel(wanted, "rad"),
        reference_velocity=channel(speed, "rad/s"),
        motor_position=channel(np.round(position / _ENCODER) * _ENCODER, "rad", Timing.SAMPLED),
        injected=Injection(channel(added, "N m"), InjectionPoint.BEFORE_LIMIT),
    )
    law = PD(
        position_gain=kp, derivative_gain=said_kd, reference_velocity="channel", period=period, interpolation="hold"
    )
    return Logged(record, ji.ClosedLoop(ji.FlexibleJoint("revolute"), law), one)


@dataclass(frozen=True)
class Said:
    """What was said of an actuator, last as a rigid joint where its stiffness is refused.

    Attributes:
        about: the drive's and the joint's true numbers.
        error: why there is no answer.
        late: error of the delay, s.
        z: errors of the values in their deviations, of the stiffness where it is given.
        moved: the largest error in standard errors of the fit.
        bound: of a refused stiffness, as a share of the true one.
        spring: that was identified, "rigid" where it was refused.
        named: what the verdict on loop and log names.
    """

    seed: int
    kind: str
    fault: str
    about: dict[str, float]
    error: str
    answer: str
    trust: str
    late: float | None
    z: dict[str, float]
    moved: float
    bound: float | None
    spring: str
    named: tuple[str, ...]

    @property
    def in_time(self) -> bool:
        """Whether the delay is within 0.3 ms."""
        return self.late is not None and abs(self.late) < _IN_TIME

    @property
    def told(self) -> bool:
        """Whether a spring is found or bounded, or none is where there is none."""
        if "stiffness" in self.about:
            return "stiffness" in self.z or (self.bound is not None and self.bound <= 1.0)
        return self.spring == "rigid" and not self.error

    @property
    def stiffness_holds(self) -> bool | None:
        """Whether the stiffness is within two deviations; None where it is not given."""
        return abs(self.z["stiffness"]) <= 2.0 if "stiffness" in self.z else None

    @property
    def named_right(self) -> bool | None:
        """Whether the fault is named, in an answer or an error; None where it moves nothing by two deviations."""
        if not (self.error or self.moved > _MOVED):
            return None
        return bool({*self.named} & RIGHT[self.fault]) or any(one in self.error for one in SAID[self.fault])


def judge(seed: int, kind: str, fault: str = "none") -> Said:
    """Identify an actuator as flexible with its delay free, with the play that it has, or as rigid if refused."""
    made = log(seed, kind, fault)
    one, loop = made.actuator, made.loop
    method = DIDIM(free=("delay",), outputs=("torque",))
    truth = one.truth
    about = {"period": one.period, "log": one.log, "noise": one.noise, "measured": float(one.measured), **truth}
    loose = replace(loop, joint=replace(ji.FlexibleJoint("revolute"), spring=find_spring("backlash")))
    spring, bound = "linear", None
    try:
        if "gap" in truth and fault == "none":  # what a linear spring gives is not looked at
            spring, loop = "backlash", loose
        found = ji.identify(made.record, loop, method)
        if spring == "linear" and "backlash" in name_causes(found):
            spring, loop = "backlash", loose
            found = ji.identify(made.record, loop, method)
        if found["stiffness"].value is None:
            spring, bound = "rigid", found.answer.found.values.get("lower_bound")
            loop = replace(loop, joint=ji.RigidJoint("revolute"))
            found = ji.identify(made.record, loop, method)
    except JointidError as error:  # with its cause, as the command line has it
        said = explain_failure(error, made.record, loop, free=method.free)
        return Said(seed, kind, fault, about, str(said), "", "", None, {}, 0.0, None, spring, ())
    rows = {row.name: row for row in found.params.rows if row.name in truth and row.value is not None}
    off = {name: row.value - truth[name] for name, row in rows.items() if row.value is not None}
    return Said(
        seed, kind, fault, about, "", str(found.answer), str(found.answer.trust.code), off.get("delay"),
        {name: off[name] / row.deviation for name, row in rows.items() if row.deviation},
        max((abs(off[name]) / row.stderr for name, row in rows.items() if row.stderr), default=0.0),
        bound / truth["stiffness"] if bound and "stiffness" in truth else None, spring, name_causes(found),
    )  # fmt: skip


@dataclass(frozen=True)
class Shown:
    """Numbers of the law that the motor position shows to be other ones, likeliest first, and what the law leaves."""

    seed: int
    kind: str
    fault: str
    left: float
    named: tuple[str, ...]

    @property
    def right(self) -> bool:
        """Whether the fault is among them; without a fault, whether there are none."""
        return not self.named if self.fault == "none" else bool({*self.named} & RIGHT[self.fault])


def judge_position(seed: int, kind: str, fault: str = "none") -> Shown:
    """Return what the motor position shows of an actuator's law, which no joint has a part in."""
    made = log(seed, kind, fault)
    left, told = explain_on_position(made.record, made.loop, {})
    return Shown(seed, kind, fault, left, tuple(one.fault.name for one in told))


def name_causes(estimate: ji.Estimate) -> tuple[str, ...]:
    """Return codes of all that the verdict on loop and log names, the likeliest first."""
    named: list[str] = []
    for verdict in estimate.checks.verdicts:
        for reason in verdict.reasons if str(verdict.subject) == "loop" else ():
            values: dict[str, Any] = dict(reason.values)
            named += [str(values.get("suspect", values.get("law", ""))), *map(str, values.get("alike", ()))]
            named += [str(cause["cause"]) for cause in values.get("causes", ())]
    return tuple(filter(None, named))


def main(arguments: Sequence[str] | None = None) -> None:
    """Write a line of JSON for each actuator, and at the end how many are right."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--first", type=int, default=20)
    parser.add_argument("--count", type=int, default=2)
    parser.add_argument("--kind", action="append", choices=KINDS)
    parser.add_argument("--fault", choices=FAULTS, default="none")
    parser.add_argument("--position", action="store_true", help="judge the law by the motor position alone")
    given = parser.parse_args(arguments)
    runs, shown = list[Said](), list[Shown]()
    for kind in given.kind or KINDS:
        seeds = range(given.first, given.first + given.count)
        judged = "studies.actuators:judge_position" if given.position else "studies.actuators:judge"
        for found in judge_seeds(judged, seeds, {"kind": kind, "fault": given.fault}):
            sys.stdout.write(json.dumps(found) + "\n")
            found |= {"named": tuple(found["named"])}
            if given.position:
                shown.append(Shown(**found))
            else:
                runs.append(Said(**found))
    if shown:
        sys.stderr.write(f"{sum(one.right for one in shown)} of {len(shown)} as they are by the motor position\n")
        return
    holds = [run.stiffness_holds for run in runs if run.stiffness_holds is not None]
    named = [run.named_right for run in runs if run.named_right is not None]
    sys.stderr.write(
        f"{len(runs)} actuators: {sum(run.told for run in runs)} with their spring found, bounded or ruled out, "
        f"{sum(run.in_time for run in runs)} with their delay within 0.3 ms, {sum(holds)} of {len(holds)} stiffnesses "
        f"within 2 sigma; fault named in {sum(named)} of {len(named)}\n"
    )


if __name__ == "__main__":
    main(sys.argv[1:])
