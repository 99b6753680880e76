"""Faults of the spring: not linear, with a backlash, and a load that is not rigid behind it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from jointid.common.text import number
from jointid.diagnostics.faults.fault import Fault, Measure, Trial, words
from jointid.diagnostics.faults.findings import AxisFaults, Finding
from jointid.diagnostics.seen import Columns, Seen
from jointid.models.joints import FlexibleJoint, springs_beside
from jointid.models.springs import Backlash, CubicSpring, ElasticLoad, ThreePieceSpring, TwoPieceSpring
from jointid.records.signals.filtering import lowpass_below_noise
from jointid.simulation.closed_loop import Simulation
from jointid.uncertainty.verdict import Reason

_SHARE, _MODES = 0.25, (1.4, 1.8, 2.3, 3.0, 4.0)  # of the load that swings, at times the first mode


def _largest_windup(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> float:
    """Return the largest wind-up of a linear spring; 0 if no other law can replace it."""
    assert run.load_position is not None
    windup = float(np.max(np.abs(run.motor_position - run.load_position)))
    possible = joint.spring.linear and values["stiffness"] > 0.0 and values["load_inertia"] > 0.0
    return windup if possible else 0.0


def _try_cubic(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    """Yield springs that are stiffer at the largest wind-up than near zero."""
    windup = _largest_windup(joint, run, values)
    for law in springs_beside(joint):
        if windup and isinstance(law, CubicSpring | ThreePieceSpring):
            for start in law.starts(values, windup):
                torque = law.torque({**values, **start}, np.array([windup]), np.zeros(1))
                more = float(torque[0]) / (start["stiffness"] * windup) - 1.0
                yield Trial(replace(joint, spring=law), start, more, more)


def _describe_cubic(finding: Finding, _: AxisFaults, spread: bool) -> str:
    s = finding.test  # "or more", as one step towards a large size is short
    size = s.show_size("%", spread=spread, factor=100.0)
    sense = "stiffer" if s.size > 0 else "softer"
    return words("the spring is not linear:", size and f"{size} or more", sense, "at the largest torque than near none")


CUBIC_SPRING = Fault(
    "cubic_spring", "spring that is not linear", describe=_describe_cubic, trials=_try_cubic, mechanical=True,
    kin="spring law", measure=Measure.SHARE, reason=Reason.SPRING_NOT_LINEAR, table="spring",
    laws=(ThreePieceSpring.name, CubicSpring.name, TwoPieceSpring.name),
)  # fmt: skip


def _try_backlash(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    windup = _largest_windup(joint, run, values)
    for law in springs_beside(joint):
        if windup and isinstance(law, Backlash):
            for start in law.starts(values, windup):
                yield Trial(replace(joint, spring=law), start, 1.0, 0.5 * start["gap"])


BACKLASH = Fault(
    "backlash", "backlash", trials=_try_backlash, mechanical=True, one_sided=True,
    describe=lambda finding, check, _: "the transmission has a backlash of some "
    f"{number(2 * finding.test.size * (finding.test.shape or 0.0), 2)} {check.on_side('position')} or more",
    kin="spring law", reason=Reason.SPRING_NOT_LINEAR, table="spring", laws=(Backlash.name,),
)  # fmt: skip


def _try_second_mode(joint: FlexibleJoint, run: Simulation, values: Mapping[str, float]) -> Iterator[Trial]:
    """Yield joints with an elastic load, at a few multiples of the first mode."""
    for law in springs_beside(joint):
        if _largest_windup(joint, run, values) and isinstance(law, ElasticLoad):
            first = joint.frequencies(values)["free_free"]
            for times in _MODES:
                start = law.start(values, _SHARE, times)
                yield Trial(replace(joint, spring=law), start, _SHARE, times * first)


SECOND_MODE = Fault(
    "second_mode", "load that swings in itself", trials=_try_second_mode,
    describe=lambda finding, *_: "a part of the load swings on a spring of its own, somewhere about "
    f"{number(finding.test.shape, 2)} Hz",
    mechanical=True, one_sided=True, measure=Measure.SHARE,
    reason=Reason.LOAD_NOT_RIGID, table="spring", laws=(ElasticLoad.name,),
)  # fmt: skip


def _bends(seen: Seen) -> Columns:
    """Yield the second derivative of the acceleration, which a spring adds to a rigid joint's torque.

    Above the limit that derivative is noise of the position, as is a part of the residual, which it then follows.
    """
    if seen.loop is None:
        smooth = lowpass_below_noise(seen.acceleration, seen.limit, seen.sample_time)
        yield None, np.gradient(np.gradient(smooth, seen.sample_time), seen.sample_time)


COMPLIANCE = Fault(
    "compliance", "gear that bends", "changes of the acceleration: a gear that bends",
    lambda *_: "a part of the torque is what a spring in this joint makes, as where a gear bends: declare its spring, "
    "or identify below its mode by a lower filtering.cutoff",
    columns=_bends, mechanical=True, reason=Reason.LOAD_NOT_RIGID,
)  # fmt: skip

FAULTS = (CUBIC_SPRING, BACKLASH, SECOND_MODE, COMPLIANCE)
