"""The linear part of a joint as a state space, continuous and sampled; in files as JSON.

With the motor's position and velocity, and the load's, as states and the torque tau as input::

    ZZ1 a1  = tau - Fv1 v1 - K12 (q1 - q12) - F12 (v1 - v12)
    ZZ2 a12 =     - Fv2 v12 + K12 (q1 - q12) + F12 (v1 - v12) - rate q12

`rate` is of a spring that carries the load (`models.position_forces`). A rigid joint has the first line alone, without
the spring. What is not linear, Coulomb friction and a weight that turns, is not in it, nor what is constant: it
describes motion that does not reverse, about a steady one, less the constant forces.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from jointid import __version__
from jointid.common.arrays import FloatArray
from jointid.common.document import dumps
from jointid.common.errors import MethodError, extra
from jointid.common.parameters import Quantity, unit_of
from jointid.common.text import number as shown
from jointid.models.joints import FlexibleJoint
from jointid.models.linear import OUTPUTS, discretise, drive_matrices
from jointid.output.export.joint_model import JointModel
from jointid.output.json import plain
from jointid.output.json.estimates import ESTIMATE_SCHEMA, Json

STATE_SPACE_SCHEMA = "jointid.state-space/1"

_MOST = 1000  # periods of delay: each is a state


@dataclass(frozen=True, slots=True, eq=False)
class StateSpace:
    """Linear system ``x' = A x + B u, y = C x + D u``; a difference equation if it has a period.

    Attributes:
        A, B, C, D: (states, states), (states, 1), (outputs, states), (outputs, 1).
        units: of each state that is a position or a velocity, of the torque and of nothing else, by name.
        states, inputs, outputs: their names.
        period: seconds between samples, None where it is continuous.
        delay: seconds from a sample of the torque to its effect.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    units: Mapping[str, str]
    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    period: float | None = None
    delay: float = 0.0

    def discretise(self, period: float, delay: float = 0.0) -> StateSpace:
        """Discretise with a zero-order hold on the torque, exact at the samples (`models.linear`).

        Each torque that is still on its way is a state, ``torque_1`` the newest.

        Args:
            period: T, seconds.
            delay: seconds from a sample of the torque to its effect.

        Raises:
            MethodError: the system is discrete already, or the period or the delay is out of range.
        """
        if self.period is not None or not 0 < period < math.inf or not 0 <= delay <= _MOST * period:
            raise MethodError(
                f"A continuous state space is sampled with a positive period and a delay from 0 to {_MOST} of them; "
                f"received {period} s and {delay} s" + (", and it is sampled already." if self.period else ".")
            )
        made = discretise(self.A, self.B[:, 0], period, delay)
        order, waiting = len(self.A), made.waiting
        A, B = np.zeros((order + waiting, order + waiting)), np.zeros((order + waiting, 1))
        A[:order, :order] = made.transition
        for lag, column in ((made.whole, made.new), (made.whole + 1, made.old)):
            if lag == 0:
                B[:order, 0] = column
            elif lag <= waiting:
                A[:order, order + lag - 1] = column
        if waiting:
            B[order, 0] = 1.0
            A[order + 1 :, order:-1] = np.eye(waiting - 1)
        C = np.hstack([self.C, np.zeros((len(self.C), waiting))])
        names = tuple(f"torque_{i + 1}" for i in range(waiting))
        states = (*self.states, *names)
        return StateSpace(A, B, C, self.D, self.units, states, self.inputs, self.outputs, period, delay)

    def scipy(self) -> Any:
        """Return it as SciPy's `StateSpace`: of `lti`, or of `dlti` where there is a period."""
        from scipy import signal

        timed = {} if self.period is None else {"dt": self.period}
        return signal.StateSpace(self.A, self.B, self.C, self.D, **timed)

    def control(self) -> Any:
        """Return python-control's `StateSpace`, its signals named.

        Raises:
            ExtraError: python-control is not there.
        """
        control = extra("control", "models", "A state space for python-control")
        dt = 0 if self.period is None else self.period
        names = {"states": list(self.states), "inputs": list(self.inputs), "outputs": list(self.outputs)}
        return control.ss(self.A, self.B, self.C, self.D, dt, **names)


def linear_part(model: JointModel) -> StateSpace:
    """Return the linear part of a joint, continuous: from the torque on its side to every position and velocity.

    Raises:
        MethodError: a value is refused, no joint can have it, or the spring is not linear.
    """
    if isinstance(model.joint, FlexibleJoint):
        model.joint.require_linear_spring("A state space takes")
    masses, weight = model.masses.values(), model.weight
    rate = 0.0 if weight is None else weight.rate
    A, b = drive_matrices(
        [mass.inertia for mass in masses], [mass.viscous for mass in masses], model.stiffness, model.damping, rate
    )
    states: tuple[str, ...] = OUTPUTS[: len(A)]
    quantities = (Quantity.POSITION, Quantity.VELOCITY)
    units = {name: unit_of(quantities[i % 2], model.kind, model.torque_unit) for i, name in enumerate(states)}
    units["torque"] = model.torque_unit
    return StateSpace(
        A, b[:, np.newaxis], np.eye(len(A)), np.zeros((len(A), 1)), units, states, ("torque",), states
    )  # fmt: skip


def state_space_json(
    model: JointModel, *, period: float | None = None, delay: float | None = None
) -> tuple[str, tuple[str, ...]]:
    """Return a state space as JSON, for SciPy, python-control, MATLAB and whatever reads numbers; and its losses.

    Args:
        model: the joint.
        period: s, to sample it with; without it the record's sample time.
        delay: s, from a sample of the torque to its effect; without it as the joint was identified with.

    Raises:
        MethodError: a time is impossible, a value is refused, or no joint can have it.
    """
    continuous, sampled = _both(model, period, delay)
    lost = _not_linear(model)
    answer: Json = {
        "schema": STATE_SPACE_SCHEMA,
        "jointid": __version__,
        "name": model.name,
        "model": model.joint.model,
        "kind": model.kind,
        "side": model.side,
        "motor_torque_to_input": model.gear,
        "units": dict(continuous.units),
        "continuous": _matrices(continuous),
        "sampled": {"period": sampled.period, "delay": sampled.delay} | _matrices(sampled),
        "parameters": {p.name: plain(p) for p in model.parameters},
        "source": {
            "schema": ESTIMATE_SCHEMA,
            "method": model.estimate.settings.method,
            "records": [{"name": model.data.record, "torque_sha256": one or None} for one in model.data.fingerprints],
        },
        "lost": list(lost),
    }
    return dumps(answer), lost


def _both(model: JointModel, period: float | None, delay: float | None) -> tuple[StateSpace, StateSpace]:
    """Return the linear part, continuous and sampled."""
    if not (period is None or 0 < period < math.inf) or not (delay is None or 0 <= delay < math.inf):
        raise MethodError(
            f"A period is a positive number of seconds, a delay 0 or more; received {period} and {delay}."
        )
    continuous = linear_part(model)
    return continuous, continuous.discretise(period or model.data.sample_time, model.delay if delay is None else delay)


def _not_linear(model: JointModel) -> tuple[str, ...]:
    """Return a sentence for each part of a joint that its state space does not have."""
    unit, weight, masses = model.torque_unit, model.weight, model.masses
    lost = [
        f"the Coulomb friction of the {name}, {shown(mass.coulomb)} {unit}, and with it all sticking"
        for name, mass in masses.items()
        if mass.coulomb
    ]
    constants = {name: mass.shift for name, mass in masses.items()} | {"motor": model.friction_shift}
    lost += [f"a constant force of {shown(force)} {unit} on the {name}" for name, force in constants.items() if force]
    if weight is not None and weight.constant:
        lost.append(f"the constant load, {shown(weight.constant)} {unit}")
    if weight is not None and weight.turns:
        lost.append("the weight, which follows the cosine and the sine of the position")
    law = model.joint.friction
    lost += [law.adds] if law.adds else []
    return (*lost, *model.lost())


def _matrices(system: StateSpace) -> Json:
    return {
        "states": list(system.states),
        "inputs": list(system.inputs),
        "outputs": list(system.outputs),
        **{letter: getattr(system, letter).tolist() for letter in "ABCD"},
    }
