"""Drives whose mechanics are not the model: what their stiffness is then said to be, and whether that is noticed.

The drives are those of `studies.healthy`, each with one thing of its mechanics wrong, simulated by another hand: time
steps of 10 us, in each of which friction is an impulse that at most stops its mass (J. J. Moreau, "Unilateral contact
and dry friction in finite freedom dynamics", 1988). Their controller is the declared one.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Any

import numba
import numpy as np
from scipy.signal import lfilter

import jointid as ji
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.models.friction import Friction
from jointid.models.springs import Spring
from jointid.simulation.loop_input import AxisInput, prepare
from studies.healthy import Drive, drive

FAULTS = (
    "none", "cubic spring", "backlash", "load-dependent friction", "changing friction", "presliding", "cogging",
    "second mode", "spring in pieces", "stribeck", "motor load friction", "saturation", "lost samples", "gravity",
    "uneven friction",
)  # fmt: skip
PAIRS = (
    "cubic spring, cogging", "cubic spring, load-dependent friction", "saturation, cogging",
    "saturation, changing friction", "load-dependent friction, cogging",
)  # fmt: skip
RIGHT = {  # what the check should call them
    "cubic spring": ("cubic_spring",), "spring in pieces": ("cubic_spring",), "backlash": ("backlash",),
    "load-dependent friction": ("load_dependent_friction",), "motor load friction": ("load_dependent_friction",),
    "changing friction": ("changing_friction",), "presliding": ("winding_friction", "presliding"),
    "cogging": ("cogging",), "second mode": ("second_mode",), "stribeck": ("stribeck", "presliding"),
    "saturation": ("torque_saturation",), "lost samples": ("lost_samples",), "gravity": ("gravity",),
    "uneven friction": ("uneven_friction",),
}  # fmt: skip
_STEP = 1e-5  # s
_SETTLED = 1.0  # s until a load hangs still
_MOST_LOST = 8  # samples at one instant
_BY_ONE_NUMBER = {  # and what that is a share of
    "load-dependent friction": ("loss", ""), "presliding": ("presliding", "travel"),
    "changing friction": ("warming", ""), "motor load friction": ("motor_loss", ""),
}  # fmt: skip
_NEWER = ("saturation", "gravity", "uneven friction")

# What the simulation reads, by its place in a row: the drive, then what is wrong with it.
_ORDER = (
    "motor_inertia", "motor_viscous", "motor_coulomb", "stiffness", "damping", "load_inertia", "load_viscous",
    "load_coulomb", "offset",
    "cubic",  # 1/rad2, the spring is stiffer by this times the square of its wind-up
    "gap",  # rad, half of the backlash
    "third_inertia", "third_stiffness", "third_damping",  # of what the load carries
    "loss",  # friction of the load per torque through the spring
    "presliding",  # rad of wind-up of the friction, for both masses
    "cogging", "pitch",  # N m, rad
    "warming",  # the viscous friction falls by this share from beginning to end
    "bend", "more", "next_bend", "still_more",  # rad, N m/rad: from these wind-ups on the spring is stiffer by that
    "rise", "slow",  # share of the Coulomb friction that is added to it below that speed, rad/s, on both sides
    "sag", "peak",  # share of the torque that the motor does not make at that torque, N m, and of its square below
    "weight", "tilt",  # N m of the load, which hangs down at that angle, rad
    "motor_loss",  # friction of the motor per torque through the spring
    "uneven", "span", "middle",  # share of the friction that is added to it at that distance from a position, rad
)  # fmt: skip


@numba.njit(cache=False)
def _times(q, v, rise, slow, uneven, span, middle):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return how many times as large the Coulomb friction is at a position and a speed."""
    more = 1.0 + (rise * math.exp(-((v / slow) ** 2)) if slow > 0.0 else 0.0)
    return more * (1.0 + uneven * (q - middle) / span) if uneven != 0.0 else more


@numba.njit(cache=False)
def _run(  # type: ignore[no-untyped-def]
    d, A, Bq, C, D, state, feedforward, driven, after, lag, period, steps, first
):  # pragma: no cover
    periods = feedforward.size
    h = period / steps
    (
        m1, b1, f1, k, c, m2, b2, f2, offset, cubic, gap, m3, k3, c3, loss, soft, cogging, pitch, warming,
        bend, more, next_bend, still_more, rise, slow, sag, peak, weight, tilt, motor_loss, uneven, span, middle,
    ) = d  # fmt: skip
    z = state.copy()
    q1, q2, q3, v1, v2, v3 = first, first, first, 0.0, 0.0, 0.0
    z1, z2 = 0.0, 0.0  # of the presliding friction, -1 to 1
    out, acting = np.empty(periods), np.empty(periods)
    wound, before = 0.0, 0.0
    for i in range(periods):
        u = feedforward[i] + D * q1
        for j in range(z.size):
            u += C[j] * z[j]
        z = A @ z + Bq * q1 + (driven[i] if driven.shape[0] else np.zeros(z.size))
        out[i] = u
        acting[i] = u + after[i]
        acting[i] *= 1.0 - (sag * (acting[i] / peak) ** 2 if sag != 0.0 else 0.0)
        torque = acting[i - lag] if i >= lag else acting[0]
        left = 1.0 - warming * i / periods
        for step in range(steps):
            e, de = q2 - q1, v2 - v1
            open_e = e - min(max(e, -gap), gap)
            spring = k * open_e * (1.0 + cubic * open_e * open_e)
            if bend > 0.0:
                size = abs(e)
                spring += math.copysign(more * max(size - bend, 0.0) + still_more * max(size - next_bend, 0.0), e)
            if gap == 0.0 or open_e != 0.0:
                spring += c * de
            wound = max(wound, abs(e))
            # Speeds are those half a step later than places; a torque that begins here acts on half of the way there.
            push1 = (torque if step or not i else 0.5 * (before + torque)) - offset + spring - left * b1 * v1
            if cogging != 0.0:
                push1 -= cogging * math.sin(2 * math.pi * q1 / pitch)
            push2 = -spring - left * b2 * v2 - weight * math.sin(q2 - tilt)
            held1 = f1 * _times(q1, v1, rise, slow, uneven, span, middle) + motor_loss * abs(spring)
            held2 = f2 * _times(q2, v2, rise, slow, uneven, span, middle) + loss * abs(spring)
            if m3 > 0.0:
                third = k3 * (q3 - q2) + c3 * (v3 - v2)
                push2 += third
                v3 -= h * third / m3
                q3 += h * v3
            if soft > 0.0:  # Dahl's: the friction winds up over a displacement
                z1 += h * (v1 - abs(v1) * z1) / soft
                z2 += h * (v2 - abs(v2) * z2) / soft
                v1 += h * (push1 - held1 * z1) / m1
                v2 += h * (push2 - held2 * z2) / m2
            else:
                v1 += h * push1 / m1
                v2 += h * push2 / m2
                v1 = math.copysign(max(abs(v1) - h * held1 / m1, 0.0), v1)
                v2 = math.copysign(max(abs(v2) - h * held2 / m2, 0.0), v2)
            q1 += h * v1
            q2 += h * v2
        before = torque
    return out, wound


def simulate(axis: Drive, values: dict[str, float], after: FloatArray) -> tuple[FloatArray, AxisInput, float]:
    """Return the controller's output at its instants, the loop's input, and the largest wind-up, by small steps."""
    whole = prepare(axis.loop, axis.record)
    experiment, feedback, law = whole.axis, whole.sampled, whole.axis.law
    assert law.phases == 1 and whole.clock.lengths.size == 1  # a delay of whole periods
    steps = max(round(law.period / _STEP), 1)
    row = np.array([values.get(name, 0.0) for name in _ORDER])
    first = float(experiment.inputs[0, 0])
    state = experiment.state + experiment.memory[:, 0] * first
    out, wound = _run(
        row, feedback.A[0, 0], feedback.Bq[0, 0], feedback.C[0, 0, law.output], float(feedback.D[0, 0, law.output]),
        state, np.ascontiguousarray(experiment.feedforward[law.output]), feedback.driven[0], after,
        int(whole.clock.lags[0, 0]), law.period, steps, first,
    )  # fmt: skip
    return out, experiment, float(wound)


@dataclass(frozen=True)
class Spoiled:
    """A record of a drive whose mechanics are not the model, the drive, how large the fault is, and what it has."""

    record: ji.Record
    axis: Drive
    size: float
    truth: dict[str, float]

    def stiffness(self, spring: str) -> float:
        """Return the stiffness that a spring of that name has; of a load that swings in itself, that of both springs.

        An elastic load has the first of them alone. A load of which a share hangs on a second spring lags behind the
        motor, where it is accelerated, as one does whose spring is as soft as both: by `1/K12 + share^2/K23`.
        """
        first, third = self.axis.truth["stiffness"], self.truth.get("third_inertia", 0.0)
        if not third or spring == "elastic-load":
            return first
        share = third / (third + self.truth["load_inertia"])
        return 1 / (1 / first + share**2 / self.truth["third_stiffness"])


def spoiled(seed: int, fault: str, longest: float = 12.0, noise: str = "") -> Spoiled | None:
    """Return a drive of `studies.healthy` with one fault; None where its loop is not stable with it.

    Springs that are 11 to 94 % stiffer at the largest wind-up, gaps of 0.1 to 2 such wind-ups, modes at 1.5 to 4 times
    the first, friction of 2 to 15 % of the load's torque on either side, friction that winds up over 1e-4 to 1e-2 of
    the travel, cogging of 1 to 5 % of the torque, a viscous friction that falls by 20 to 60 %, springs of three
    stiffnesses of which the last is 20 to 100 % above the first, from a quarter and a half of the largest wind-up on, a
    Coulomb friction that is 60 % smaller to 80 % larger towards standstill, below 1 to 10 % of the largest speed, a
    motor that makes 6 to 14 % less than its current says at the peak, 1 to 8 samples that are lost at one to three
    instants of the motion, a hanging load of 20 to 100 % of the torque's scatter, Coulomb friction that rises by 10 to
    30 % from either end of the travel to its middle, and as much beyond.
    """
    axis = drive(seed, longest, noise)
    rng = np.random.default_rng([seed, 19])
    record, truth, about = axis.record, dict(axis.truth), axis.about
    assert record.torque is not None and record.reference is not None
    experiment = prepare(axis.loop, record).axis
    clean, _, wound = simulate(axis, truth, experiment.after_limit)
    scale, travel = float(np.std(clean)), float(np.ptp(record.reference.values))
    given = {
        "cubic spring": rng.uniform(0.11, 0.94), "backlash": 0.1 * 20 ** rng.uniform(),
        "second mode": rng.uniform(1.5, 4.0), "load-dependent friction": rng.uniform(0.02, 0.15),
        "presliding": 10 ** rng.uniform(-4, -2), "cogging": rng.uniform(0.01, 0.05),
        "changing friction": rng.uniform(0.2, 0.6), "spring in pieces": 0.0, "stribeck": rng.uniform(-0.6, 0.8),
    }  # fmt: skip
    faults, size = fault.split(", "), 0.0
    for one in faults:
        size = given.get("load-dependent friction" if one == "motor load friction" else one, 0.0)
        if one == "cubic spring":
            truth["cubic"] = size / wound**2
        elif one == "backlash":
            truth["gap"] = 0.5 * size * wound
        elif one == "spring in pieces":
            size, (first, second) = rng.uniform(0.2, 1.0), (rng.uniform(0.15, 0.35), rng.uniform(0.45, 0.65))
            truth |= {"bend": first * wound, "next_bend": second * wound}
            truth |= {"more": 0.5 * size * truth["stiffness"], "still_more": 0.5 * size * truth["stiffness"]}
        elif one == "second mode":  # a third of the load on a spring of its own
            third = truth["load_inertia"] / 3
            pulsation = 2 * math.pi * about["mode"] * size
            truth |= {"load_inertia": 2 * third, "third_inertia": third, "third_stiffness": third * pulsation**2}
            truth["third_damping"] = 0.02 * third * pulsation
        elif one == "cogging":
            truth |= {"cogging": size * scale, "pitch": travel / rng.uniform(5, 40)}
        elif one == "stribeck":
            fastest = float(np.max(np.abs(np.gradient(record.reference.values)))) / record.reference.sample_time
            truth |= {"rise": size, "slow": fastest * 10 ** rng.uniform(-2, -1)}
        elif one in _BY_ONE_NUMBER:
            name, unit = _BY_ONE_NUMBER[one]
            truth[name] = size * (travel if unit == "travel" else 1.0)
        elif one in _NEWER:
            size, values = _draw_newer(seed, one, clean, record.reference.values)
            truth |= values
    for _ in range(3 if "saturation" in faults else 0):  # less torque takes more current
        current = simulate(axis, truth, experiment.after_limit)[0] + experiment.after_limit
        truth["peak"] = float(np.abs(current).max())
    drawn = scale * _draw_noise(rng, about, record.torque.values.size)
    on_log = about["noise"] == "log"
    # A load hangs in balance before its record begins.
    rest = np.zeros(round(_SETTLED / about["period"]) if "gravity" in faults else 0)
    held = record.reference.values[0] + rest
    before = replace(record.reference, values=np.concatenate([held, record.reference.values]))
    resting = replace(axis, record=ji.Record(reference=before)) if rest.size else axis
    after = np.concatenate([rest, experiment.after_limit + (0.0 if on_log else drawn)])
    out = simulate(resting, truth, after)[0][rest.size :]
    shown = out + experiment.shown + (drawn if on_log else 0.0)
    if not np.all(np.isfinite(shown)) or np.abs(shown).max() > 10 * np.abs(clean).max():
        return None
    made = replace(record, torque=replace(record.torque, values=shown))
    return Spoiled(lose(made, seed) if "lost samples" in faults else made, axis, size, truth)


def _draw_noise(rng: np.random.Generator, about: dict[str, Any], samples: int) -> FloatArray:
    """Return the noise of a drive, as a share of its torque's scatter."""
    noise = rng.standard_normal(samples)
    if about["noise"] == "coloured force":
        noise = lfilter([1.0], [1.0, -math.exp(-about["period"] * 2 * math.pi * rng.uniform(2, 30))], noise)
    return np.asarray(noise * about["size"] / noise.std())


def _draw_newer(seed: int, fault: str, torque: FloatArray, reference: FloatArray) -> tuple[float, dict[str, float]]:
    """Return the size of a fault, by draws that leave those of the others as they are, and its numbers."""
    rng = np.random.default_rng([seed, 20])
    low, high = float(reference.min()), float(reference.max())
    if fault == "saturation":
        size = rng.uniform(0.06, 0.14)
        return size, {"sag": size, "peak": float(np.abs(torque).max())}
    if fault == "gravity":
        size = rng.uniform(0.2, 1.0)
        return size, {"weight": size * float(np.std(torque)), "tilt": rng.uniform(-math.pi, math.pi)}
    size = float(rng.choice([-1, 1])) * rng.uniform(0.1, 0.3)
    return size, {"uneven": size, "span": 0.5 * (high - low), "middle": 0.5 * (low + high)}


def lose(record: ji.Record, seed: int) -> ji.Record:
    """Return a record without 1 to 8 samples at one to three instants of its motion, and nothing in their place."""
    assert record.reference is not None
    rng = np.random.default_rng([seed, 21])
    moving = np.flatnonzero(np.diff(record.reference.values)[:-_MOST_LOST])
    first = rng.choice(moving, rng.integers(1, 4))
    rows = [one + np.arange(rng.integers(1, _MOST_LOST + 1)) for one in first]
    less = {name: replace(one, values=np.delete(one.values, np.concatenate(rows))) for name, one in record.items()}
    return record.with_channels(less)


@dataclass(frozen=True)
class Said:
    """What was said of a drive: the error of its stiffness in deviations, what is trusted, and what is named."""

    fault: str
    trust: str
    z: float | None
    named: tuple[str, ...]


def judge(
    seed: int, fault: str, longest: float = 12.0, spring: str = "linear", friction: str = "symmetric"
) -> Said | None:
    """Identify a drive with a fault, by a model with that spring and friction; None where there is none."""
    made = spoiled(seed, fault, longest)
    if made is None:
        return None
    loop = made.axis.loop
    assert isinstance(loop.joint, ji.FlexibleJoint)
    loop = replace(loop, joint=replace(loop.joint, spring=Spring(spring), friction=Friction(friction)))
    try:
        found = ji.identify(made.record, loop)
    except JointidError:
        return Said(fault, "", None, ())
    row, truth = found["stiffness"], made.stiffness(spring)
    named = [
        str(values.get("suspect", values.get("law", values.get("cause", ""))))
        for reason in [one for one in found.checks if one.name == "loop"]
        for values in reason.values.get("causes", [reason.values])
    ]
    z = (row.value - truth) / row.deviation if row.value is not None and row.deviation else None
    return Said(fault, str(found.answer.trust.code), z, tuple(filter(None, named)))
