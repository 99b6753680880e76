"""A solved axis: its motion, and its torque's response to a force."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError
from jointid.common.transmission import Side
from jointid.estimation.problems.simulated import ClosedLoopProblem
from jointid.models.friction import Friction
from jointid.models.joints import FlexibleJoint
from jointid.models.springs import Spring
from jointid.records.record import Tap
from jointid.simulation.loop_input import to_log
from jointid.simulation.simulate import Simulation, require_success

Columns: TypeAlias = Iterable[tuple[float | None, FloatArray | None]]
"""Shapes of a fault, and what each adds to the torque per unit of its size, (samples,); None where that fails."""

_SPEEDS = (0.02, 0.04, 0.08, 0.16)  # of the largest speed: the Stribeck speeds that are tried, of a loop but the last
_WILD = 10.0  # times the torque: a loop that is unstable with a law so different is not that of the record
_FORCE = 1e-3  # of the largest torque: small enough for the friction to answer it linearly


@dataclass(frozen=True)
class Seen:
    """One axis of a loop or of a robot.

    Attributes:
        position, velocity, acceleration: (samples,) of its motor.
        asked, torque: (samples,) of its controller, and with additions after it.
        through: (samples,) torque that loads its gear.
        sample_time: of all of these, s.
        others: velocity and acceleration of the other axes, by name.
        force: returns the change of the logged torque by a force on the motor, (samples,), 0 if that is unknown; and
            by what the log shows of that force itself, if it does.
        loop: its problem and solution, if simulated as a loop of its own.
        residual, own: (rows,) of that problem, and (rows, free) columns of its parameters.
        trials: problem and start of each joint with other laws, by the identity of its torque change.
    """

    position: FloatArray
    velocity: FloatArray
    acceleration: FloatArray
    asked: FloatArray
    torque: FloatArray
    through: FloatArray
    sample_time: float
    force: Callable[..., FloatArray]
    others: Mapping[str, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    loop: tuple[ClosedLoopProblem, FloatArray] | None = None
    residual: FloatArray = field(default_factory=lambda: np.zeros(0))
    own: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    trials: dict[int, tuple[ClosedLoopProblem, FloatArray]] = field(default_factory=dict)

    @cached_property
    def values(self) -> Mapping[str, float]:
        """The parameters of a loop's joint, by name."""
        return {} if self.loop is None else self.loop[0].values(self.loop[1])

    @cached_property
    def at_low_speeds(self) -> list[tuple[float, FloatArray]]:
        """Speeds, and the torque's change by a unit of friction that is there below each, (samples,)."""
        fastest = float(np.max(np.abs(self.velocity), initial=0.0)) or 1.0
        speeds = [share * fastest for share in (_SPEEDS[:-1] if self.loop else _SPEEDS)]
        return [(by, self.force(-np.exp(-((self.velocity / by) ** 2)) * np.sign(self.velocity))) for by in speeds]

    @cached_property
    def plain(self) -> FloatArray:
        """The torque of a loop, (samples,)."""
        return np.zeros(0) if self.loop is None else self.loop[0].torque(self.loop[1])

    @cached_property
    def windup(self) -> float:
        """Largest wind-up of the spring; 0 without spring or load."""
        if self.loop is None or not self.values.get("stiffness", 0.0) > 0.0 or not self.values["load_inertia"] > 0.0:
            return 0.0
        run = self.loop[0].simulate(self.loop[1])
        return 0.0 if run.load_position is None else float(np.max(np.abs(run.motor_position - run.load_position)))

    def turned(self, side: Side) -> FloatArray | None:
        """Return the angle of a loop's motor or load, (samples,), of that itself; None where it does not turn."""
        if self.loop is None:
            return None
        joint, run = self.loop[0].joint, self.loop[0].simulate(self.loop[1])
        gear = joint.transmission
        position = run.motor_position if side == "motor" or run.load_position is None else run.load_position
        turns = (joint.kind if gear is None else gear.kind_of(side)) == "revolute"
        return position / (1.0 if gear is None else gear.position(side)) if turns else None

    @property
    def has_linear_friction(self) -> bool:
        """Test for piecewise linear friction, or an axis without a loop."""
        return self.loop is None or self.loop[0].joint.friction.linear

    @property
    def is_flexible(self) -> bool:
        """Test whether the axis is a loop with a spring."""
        return self.loop is not None and self.loop[0].joint.model == "flexible"

    @property
    def is_plain(self) -> bool:
        """Test for a flexible joint with symmetric friction, replaceable by other laws."""
        return self.loop is not None and self.is_flexible and self.loop[0].joint.friction == Friction()

    def vary(self, values: Mapping[str, float], size: float, **laws: Spring | Friction) -> FloatArray | None:
        """Torque change of a flexible joint by other laws, per size.

        The joint is simulated with the law, as a large change has effects of higher order. If one of the `values` that
        differ from the joint's is fixed, the result is None.
        """
        assert self.loop is not None
        problem = self.loop[0]
        changed = {name for name, value in values.items() if value != self.values.get(name)}
        if any(p.name in changed for p in problem.parameters if not p.free):
            return None
        joint: Any = replace(problem.joint, **laws)  # type: ignore[arg-type]
        other = problem.with_joint(joint)
        start = other.vector({**self.values, **values})
        try:
            faulty = require_success(other.simulate(start))
        except JointidError:  # a loop that is unstable with it is not that of the record
            return None
        raw = (faulty.torque - self.plain) / size
        self.trials[id(raw)] = other, start
        return raw if np.all(np.abs(size * raw) < _WILD * float(np.max(np.abs(self.plain)))) else None


def see_loop(problem: ClosedLoopProblem, x: FloatArray, residual: FloatArray, own: FloatArray) -> Seen:
    """Solved axis of a joint's loop; forces on it are simulated."""
    run, added = problem.simulate(x), problem.axis.after_limit
    output = problem.torque(x, lambda e: replace(e, tap=Tap.COMMAND, logged=np.zeros_like(e.logged)))

    def respond(force: FloatArray, shown: FloatArray | None = None) -> FloatArray:
        if force.size != added.size:
            return np.zeros_like(run.motor_position)  # a force at the controller's instants needs the motion there
        largest = float(np.max(np.abs(force), initial=0.0)) or 1.0
        small = _FORCE * float(np.max(np.abs(problem.measured))) / largest

        def simulate(by: float) -> FloatArray:
            return problem.torque(x, lambda e: e.push(by * force))

        try:
            raw = (simulate(small) - simulate(-small)) / (2 * small)
        except JointidError:  # a loop that is unstable with it is not that of the record
            return np.zeros_like(run.motor_position)
        # The force itself is not in a measured torque.
        raw = raw - to_log(problem.axis, force) if problem.axis.tap is Tap.MEASURED else raw
        return raw if shown is None else raw + to_log(problem.axis, shown)

    return Seen(
        run.motor_position, run.motor_velocity, run.motor.acceleration, output,
        output + added if output.size == added.size else output, _torque_through(problem, x, run),
        problem.sample_time, respond, loop=(problem, x), residual=residual, own=own,
    )  # fmt: skip


def _torque_through(problem: ClosedLoopProblem, x: FloatArray, run: Simulation) -> FloatArray:
    """Torque through a joint's spring, or on a rigid mass, (samples,)."""
    joint = problem.joint
    if not isinstance(joint, FlexibleJoint):
        return run.push
    assert run.load_position is not None and run.load_velocity is not None
    wound, rate = run.motor_position - run.load_position, run.motor_velocity - run.load_velocity
    return joint.spring.torque(problem.values(x), wound, rate)
