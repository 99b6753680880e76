"""Random flexible drives under random loops: the plants a solver must get through, whatever their size and speed.

Two families. Prismatic: the paper's axis with a free-free mode of 15 to 55 Hz, a load share of 0.2 to 0.85 and 60 to
150 kg, under the loop of the EMPS benchmark. Rotary: inertias from 1e-5 to 1e3 kg m2, 5 to 400 Hz, 0.3 to 10 % damping,
sampled at 250 Hz to 16 kHz with the mode from a 160th to a fifth of it, under a loop that suits the drive.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from jointid.models.controllers import Cascade
from jointid.models.friction import PARTS, Friction
from jointid.models.joints import ClosedLoop, FlexibleJoint
from jointid.models.position_forces import Counterbalance, Gravity, PositionHarmonics
from jointid.models.springs import SPRINGS, Spring
from jointid.records.chunks import cut
from jointid.records.record import Record
from jointid.simulation.excitation import pulses, trapezoids
from jointid.simulation.loop_input import prepare
from jointid.simulation.simulate import Outcome
from jointid.simulation.synthesis import simulate, simulated_record

_GAIN = 35.15065188


@dataclass(frozen=True)
class Case:
    """A drive, its loop, what is known of it, and its noise-free record."""

    loop: ClosedLoop
    truth: dict[str, float]
    clean: Record
    mode: float  # free-free, Hz

    def noisy(self, share: float, seed: int) -> Record:
        """The record with white noise of so large a share of the torque's variation on the log."""
        torque = self.clean.torque
        assert torque is not None
        noise = np.random.default_rng(seed).standard_normal(torque.values.size)
        return replace(self.clean, torque=replace(torque, values=torque.values + share * np.std(torque.values) * noise))


def _values(inertia: float, share: float, mode: float, damping: float, friction: tuple[float, ...]) -> dict[str, float]:
    motor, load = (1 - share) * inertia, share * inertia
    reduced = motor * load / inertia
    return {
        "motor_inertia": motor,
        "motor_viscous": friction[0],
        "motor_coulomb": friction[1],
        "stiffness": reduced * (2 * math.pi * mode) ** 2,
        "damping": 2 * damping * reduced * 2 * math.pi * mode,
        "load_inertia": load,
        "load_viscous": friction[2],
        "load_coulomb": friction[3],
        "offset": friction[4],
    }


def prismatic(seed: int) -> Case:
    """The paper's axis, otherwise made."""
    rng = np.random.default_rng([seed, 1])
    reference = trapezoids((0.042, 0.083, 0.125), 0.83, 0.2, 1e-3, duration=24.0)
    known = pulses(reference.size, 1e-3, height=150.0, width=0.02, every=0.4, seed=seed)
    controller = Cascade(position_gain=160.18, velocity_gain=243.45, velocity_filter=(0.5, 0.5), gain=_GAIN, limit=1e3)
    while True:
        friction = (*rng.uniform(0.5, 1.5, 4) * (92.0, 10.0, 110.0, 10.4), rng.uniform(-5, 5))
        mode = math.exp(rng.uniform(math.log(15), math.log(55)))
        truth = _values(rng.uniform(60, 150), rng.uniform(0.2, 0.85), mode, rng.uniform(0.01, 0.05), friction)
        loop = ClosedLoop(FlexibleJoint("prismatic"), controller)
        case = _driven(loop, reference, known, truth, 1e-3, mode)
        if case is not None:
            return case


def rotary(seed: int) -> Case:
    """A rotary joint of any size and speed."""
    rng = np.random.default_rng([seed, 2])
    while True:
        inertia = 10 ** rng.uniform(-5, 3)
        mode = math.exp(rng.uniform(math.log(5), math.log(400)))
        rate = math.exp(rng.uniform(math.log(max(250.0, 5 * mode)), math.log(min(16e3, 160 * mode))))
        period, swing = 1 / rate, 10 ** rng.uniform(-1, 1)
        share, damping = rng.uniform(0.2, 0.85), math.exp(rng.uniform(math.log(0.003), math.log(0.1)))
        # Everything else is that of the paper's axis, in units of the mode's period and of the swing.
        pace = 30.0 / mode
        speeds = tuple(swing / pace * np.array([0.21, 0.415, 0.625]))
        reference = trapezoids(
            speeds, 4.15 * swing / pace**2, swing, period, duration=min(24.0 * pace, 60_000 * period)
        )
        torque = inertia * swing / pace**2  # of the accelerations
        known = pulses(reference.size, period, height=7.0 * torque, width=0.02 * pace, every=0.4 * pace, seed=seed)
        level = rng.uniform(0.5, 1.5, 4)
        viscous, coulomb = 0.95 * inertia / pace, torque
        friction = (*level * (viscous, 0.5 * coulomb, viscous, 0.5 * coulomb), rng.uniform(-0.2, 0.2) * torque)
        truth = _values(inertia, share, mode, damping, friction)
        velocity = inertia * 2 * math.pi * mode * rng.uniform(0.25, 0.6)
        controller = Cascade(position_gain=2 * math.pi * mode * rng.uniform(0.2, 0.6), velocity_gain=velocity)
        loop = ClosedLoop(FlexibleJoint(kind="revolute"), controller)
        case = _driven(loop, reference, known, truth, period, mode)
        if case is not None:
            return case


def _driven(
    loop: ClosedLoop, reference: np.ndarray, known: np.ndarray, truth: dict[str, float], period: float, mode: float
) -> Case | None:
    """The case, unless the loop is unstable or rings for ever."""
    from jointid.records.record import Channel, Injection, InjectionPoint

    position, force = ("m", "N") if loop.joint.kind == "prismatic" else ("rad", "N m")
    driven = Record(
        reference=Channel(reference, position, period),
        injected=Injection(Channel(known, force, period), InjectionPoint.AFTER_LIMIT, True),
    )
    run = simulate(loop, prepare(loop, driven), truth)
    plain = loop.controller.law(period)
    size = plain.stiffness * np.ptp(reference)
    if run.outcome is not Outcome.FINISHED or np.max(np.abs(run.torque)) > size:
        return None
    late = np.std(np.diff(run.torque)[-len(reference) // 8 :])
    if late > 2 * np.std(np.diff(run.torque)[: len(reference) // 2]):
        return None
    clean = simulated_record(loop, reference, truth, sample_time=period, injected=known)
    return Case(loop, truth, clean.without("motor_position", "load_position"), mode)


def with_spring(loop: ClosedLoop, spring: Spring) -> ClosedLoop:
    """The loop of a flexible joint with another spring."""
    assert isinstance(loop.joint, FlexibleJoint)
    return replace(loop, joint=replace(loop.joint, spring=spring))


def sprung_axis(spring: str = "backlash") -> tuple[Case, Record]:
    """An axis with a spring that shows, and its record with 2 % of noise on the log."""
    case = prismatic(1)
    clean = cut(case.clean, 0, 4000)
    loop, truth = with_law(replace(case, clean=clean), spring)
    torque = simulate(loop, prepare(loop, clean), truth).torque
    noise = 0.02 * np.std(torque) * np.random.default_rng(1).standard_normal(torque.size)
    assert clean.torque is not None
    record = replace(clean, torque=replace(clean.torque, values=torque + noise))
    return replace(case, loop=loop, truth=truth), record


LAWS = (
    "presliding",
    "load-dependent",
    "presliding-load-dependent",
    "drifting",
    "cubic",
    "hysteretic",
    "elastic-load",
    "ripple",
)
"""Smooth laws."""
PIECES = ("stribeck", "three-piece", "backlash")
"""Laws in pieces."""


GRAVITIES = {"balanced": Gravity("constant", Counterbalance(rate=1.0)), "link": Gravity("link")}


def with_law(case: Case, *laws: str) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with laws that show, of friction, spring, ripple ("ripple", "load ripple") and gravity; its values."""
    joint, truth = case.loop.joint, case.truth
    own = simulate(case.loop, prepare(case.loop, case.clean), truth)
    windup = 0.0 if own.load_position is None else float(np.max(np.abs(own.motor_position - own.load_position)))
    travel, stiffness = float(np.ptp(own.motor_position)), truth.get("stiffness", 0.0)
    duration, fastest = own.torque.size * own.sample_time, float(np.max(np.abs(own.motor_velocity)))
    for law in laws:
        if any(word in law for word in SPRINGS):
            joint = replace(joint, spring=Spring(law))  # type: ignore[arg-type]
        elif law in GRAVITIES:
            joint = replace(joint, gravity=GRAVITIES[law])
        elif "ripple" in law:
            joint = replace(joint, ripple=PositionHarmonics(0.1 * travel, side="load" if "load" in law else "motor"))
        else:
            joint = replace(joint, friction=Friction(law))
    weight = 3.0 * truth[f"{joint.sides[0]}coulomb"]
    known = truth | {
        "cubic_stiffness": 0.6 * stiffness / (windup or 1.0) ** 2, "gap": 0.5 * windup,
        "hysteresis_stiffness": 0.5 * stiffness, "hysteresis_torque": 0.1 * stiffness * windup, "swinging_share": 0.4,
        "swinging_stiffness": 2.5 * stiffness, "swinging_damping": truth.get("damping", 0.0), "stiffness_2": stiffness,
        "stiffness_3": 1.4 * stiffness, "torque_1": 0.3 * stiffness * windup, "torque_2": 0.6 * stiffness * windup,
        "gravity_constant": weight, "gravity_cos": weight, "gravity_sin": 0.3 * weight,
        "counterbalance_rate": 0.3 * stiffness,
    }  # fmt: skip
    known["stiffness"] = (0.6 if {"two-piece", "three-piece"} & {*laws} else 1.0) * stiffness
    for side in joint.sides:
        viscous, coulomb = (truth[f"{side}{part}"] for part in PARTS)
        less = side == "load_"
        more = {
            "stribeck_force": 0.4 * coulomb, "stribeck_speed": 0.05 * fastest, "friction_per_torque": 0.15,
            "presliding_distance": (2e-3 if less else 3e-3) * travel, "viscous_drift": -0.4 * viscous / duration,
            "coulomb_drift": (-0.2 if less else -0.3) * coulomb / duration, "viscous_forwards": 1.1 * viscous,
            "viscous_backwards": 0.8 * viscous, "coulomb_forwards": 1.2 * coulomb, "coulomb_backwards": 0.9 * coulomb,
        }  # fmt: skip
        known |= {f"{side}{name}": value for name, value in more.items()}
    for prefix in ("", "load_"):
        ripple = 0.1 * (stiffness * windup or weight)
        known |= {f"{prefix}harmonic_1_cosine": ripple, f"{prefix}harmonic_1_sine": -0.5 * ripple}
    return replace(case.loop, joint=joint), {p.name: known[p.name] for p in joint.parameters}


RISES, FALLS = 1.0, -1.0  # of friction towards standstill


def slow(case: Case, rises: float) -> tuple[ClosedLoop, dict[str, float]]:
    """The drive with another friction towards standstill."""
    loop, values = with_law(case, "stribeck")
    return loop, {name: rises * value if "stribeck_force" in name else value for name, value in values.items()}


def rigid(case: Case) -> Case:
    joint = case.loop.joint
    assert isinstance(joint, FlexibleJoint)
    return replace(case, loop=replace(case.loop, joint=joint.rigid), truth=joint.rigid_sums(case.truth))
