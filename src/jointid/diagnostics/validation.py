"""Validation as the paper does it: the direct test on the same record, the cross test on another one.

The identified joint is simulated (DIDIM) or its inverse model evaluated (IDIM), and the torque compared with the
measured one, ``||Y - Ys|| / ||Y||``. Only the motor's state at the first sample is estimated anew.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.document import Document, Documented, Facts, common_facts
from jointid.common.errors import MethodError
from jointid.common.transmission import Transmission
from jointid.estimation.methods.inverse_model import idim_channels, motion_of
from jointid.estimation.problems.closed_loop import ClosedLoopProblem, initial_of, with_torque
from jointid.estimation.problems.nuisance_parameters import INITIAL_STATE
from jointid.estimation.result.estimate import (
    Estimate,
    IdentifiedJoint,
    fingerprint,
    law_fingerprint,
    relative_error,
)
from jointid.estimation.search.starts import initial_state, reconstructed_position
from jointid.models.disturbances import effect_parameters
from jointid.models.joints import Motion
from jointid.models.parameters import POSITION_UNIT
from jointid.records.checks import check_record
from jointid.records.record import Record, Resampled
from jointid.simulation.closed_loop import Initial, Simulation, require_finished
from jointid.simulation.loop_input import ClosedLoop, prepare
from jointid.solvers.gauss_newton import GaussNewton
from jointid.solvers.solve import solve

_LAGS = 40  # of the residual's autocorrelation
_STEPS = 6  # enough for two parameters that act almost linearly on the torque


@dataclass(frozen=True, slots=True, eq=False)
class Validation(Documented):
    """Agreement of an estimate's predicted torque with a record.

    Attributes:
        test: "direct" on the record it was identified from, "cross" on another.
        method: "didim" simulates the loop; "idim" evaluates the inverse model on the measured position.
        record, identified_from: names of the records.
        channels: of the record that were used.
        sample_time: of the torque, seconds.
        torque_unit: of the torque: N, N m, A or V; position_unit: of the motion: m or rad.
        measured, predicted: (samples,) raw torque.
        borders: samples left out at each end of the relative error.
        relative_error: of the raw torque; a ratio.
        filtered_error: of the filtered and decimated torque, with the estimate's own filtering; a ratio.
        tracking_error: ``||e - es|| / ||e||`` of the tracking error reference - position, where the record has a
            motor position to compare with; a ratio.
        initial: estimated motor state, for a simulation.
        simulations: number run.
        autocorrelation: (lags + 1,) of the filtered torque error, 1 at lag 0; a white one stays within `white_band`.
        rows: of the filtered torque error.
        motor: motion the error is plotted against: simulated for DIDIM, measured for IDIM.
        transmission: on whose `side` torque and motion are.
        warnings: limits of the result, one sentence each.
        resampled: resampling of the record to a uniform clock; None where it was logged so.
    """

    test: Literal["direct", "cross"]
    method: str
    record: str
    identified_from: str
    channels: tuple[str, ...]
    sample_time: float
    torque_unit: str
    position_unit: str
    measured: FloatArray
    predicted: FloatArray
    borders: tuple[int, int]
    relative_error: float
    filtered_error: float
    tracking_error: float | None
    initial: Initial | None
    simulations: int
    autocorrelation: FloatArray
    rows: int
    motor: Motion
    transmission: Transmission | None = None
    warnings: tuple[str, ...] = ()
    resampled: Resampled | None = None

    @property
    def white_band(self) -> float:
        """Twice the standard deviation of an autocorrelation of white noise, ``2 / sqrt(rows)``."""
        return float(2 / np.sqrt(self.rows))

    @property
    def outside_band(self) -> float:
        """Share of the lags beyond 0 whose autocorrelation is outside the band; about 0.05 for a white residual."""
        return float(np.mean(np.abs(self.autocorrelation[1:]) > self.white_band))

    def document(self, *, details: bool = False) -> Document:
        """Return errors and whiteness as a document; there are no further details."""
        del details
        left_out = f"{self.borders[0]} + {self.borders[1]} samples at the ends left out"
        how = "simulated from the reference" if self.method == "didim" else "computed from the measured position"
        title = (
            f"{self.test.capitalize()} test on {self.record}, of the joint identified from {self.identified_from}; "
            f"torque {how}"
        )
        raw, filtered = 100 * self.relative_error, 100 * self.filtered_error
        facts = [
            *common_facts(self.resampled, self.transmission),
            ("torque error", f"{raw:.4f} % raw ({left_out}), {filtered:.4f} % filtered"),
        ]
        if self.tracking_error is not None:
            off = f"{100 * self.tracking_error:.4f} % away from the measured tracking error"
            facts.append(("tracking error", off))
        said = (
            f"{100 * self.outside_band:.0f} % of {self.autocorrelation.size - 1} autocorrelations of the filtered "
            f"error beyond +-{self.white_band:.3f} (5 % if it were white)"
        )
        return Document(title, (Facts((*facts, ("whiteness", said), *(("warning", w) for w in self.warnings))),))


def validate(estimate: Estimate | IdentifiedJoint, record: Record) -> Validation:
    """Compare an identified joint with a record: direct test on its own record, cross test on another.

    Args:
        estimate: new or read back from a file.
        record: with the channels its method uses.

    Raises:
        RecordError: a channel is missing, or the record contradicts its description.
        MethodError: the loop cannot be simulated on this record, or the estimate is of the drive side or the open
            loop.
    """
    record.require(("torque",), "Validation")
    check_record(record)
    identified = estimate.identified if isinstance(estimate, Estimate) else estimate
    if identified.method in ("drive_side", "open_loop"):
        raise MethodError(
            "A validation simulates the closed loop of a DIDIM estimate or evaluates the inverse model of an IDIM one; "
            f'this estimate is of the method "{identified.method}": identify the other record too, and compare values.'
        )
    return (
        _validate_inverse_model(identified, record)
        if identified.loop is None
        else _validate_simulation(identified, record)
    )


def _name_test(identified: IdentifiedJoint, record: Record) -> Literal["direct", "cross"]:
    assert record.torque is not None
    return "direct" if fingerprint(record.torque.values) == identified.fingerprint else "cross"


def _validate_inverse_model(identified: IdentifiedJoint, record: Record) -> Validation:
    assert record.torque is not None
    joint, filtering, sample_time = identified.joint, identified.filtering, record.torque.sample_time
    model = motion_of(record, identified.delay, filtering, joint, identified.effects)
    values = np.array([identified.values[p.name] for p in (*joint.parameters, *effect_parameters(identified.effects))])
    measured, predicted = model.torque[0], model.columns[0] @ values
    error, _ = model.decimated(filtering, sample_time, values)
    whole, _ = model.decimated(filtering, sample_time, np.zeros_like(values))
    return Validation(
        test=_name_test(identified, record),
        method=identified.method,
        record=record.name,
        identified_from=identified.record,
        resampled=record.resampled,
        channels=(*idim_channels(joint.model), *(("injected",) if record.injected is not None else ())),
        sample_time=sample_time,
        torque_unit=record.torque.unit,
        position_unit=POSITION_UNIT[identified.joint.kind],
        measured=measured,
        predicted=predicted,
        borders=filtering.borders,
        relative_error=relative_error(measured, predicted, filtering.borders),
        filtered_error=float(np.linalg.norm(error) / np.linalg.norm(whole)),
        tracking_error=None,
        initial=None,
        simulations=0,
        autocorrelation=autocorrelate(error[: error.size // len(model.torque)]),
        rows=error.size // len(model.torque),
        motor=model.motor,
        transmission=identified.joint.transmission,
    )


def _validate_simulation(identified: IdentifiedJoint, record: Record) -> Validation:
    assert identified.loop is not None
    assert record.torque is not None
    loop, filtering = identified.loop, identified.filtering
    record.require(loop.channels, "Validation of a DIDIM estimate")
    fixed = tuple(p.fixed(identified.values[p.name]) for p in loop.joint.parameters)
    experiment = prepare(loop, record)
    measured = record.torque.values[: experiment.samples]
    around = with_torque(INITIAL_STATE, experiment, measured)
    problem = ClosedLoopProblem((*fixed, *around), measured, filtering, loop, experiment)
    x, runs = _fit_initial_state(problem)
    run = require_finished(problem.simulate(x))
    error = problem.filtered(np.column_stack([measured - run.torque, measured]))
    return Validation(
        test=_name_test(identified, record),
        method=identified.method,
        record=record.name,
        identified_from=identified.record,
        resampled=record.resampled,
        channels=(*loop.channels, *(("injected",) if record.injected is not None else ())),
        sample_time=experiment.sample_time,
        torque_unit=record.torque.unit,
        position_unit=POSITION_UNIT[identified.joint.kind],
        measured=measured,
        predicted=run.torque,
        borders=filtering.borders,
        relative_error=relative_error(measured, run.torque, filtering.borders),
        filtered_error=float(np.linalg.norm(error[:, 0]) / np.linalg.norm(error[:, 1])),
        tracking_error=_compare_tracking(record, run, filtering.borders),
        initial=initial_of(problem.values(x)),
        simulations=runs + 1,
        autocorrelation=autocorrelate(error[:, 0]),
        rows=len(error),
        motor=Motion(run.motor_position, run.motor_velocity, run.motor.acceleration),
        transmission=identified.joint.transmission,
        warnings=_list_warnings(identified, loop),
    )


def autocorrelate(error: FloatArray) -> FloatArray:
    """Return the autocorrelation of a residual at lags 0 to `_LAGS`, (lags + 1,)."""
    centred = error - error.mean()
    power = float(centred @ centred) or 1.0
    lags = min(_LAGS, error.size - 1)
    return np.array([float(centred[lag:] @ centred[: centred.size - lag]) / power for lag in range(lags + 1)])


def _list_warnings(identified: IdentifiedJoint, loop: ClosedLoop) -> tuple[str, ...]:
    if identified.controller in ("", law_fingerprint(loop)):
        return ()
    return (
        "the controller is not the one the joint was identified under; that is right only if its gains were changed",
    )


def _fit_initial_state(problem: ClosedLoopProblem) -> tuple[FloatArray, int]:
    """Return the initial state that fits best, position and velocity, and the simulations it took.

    A motor at rest and a moving one are two problems (see `didim`), so both are solved.
    """
    try:
        start = initial_state(problem, reconstructed_position(problem))
    except MethodError:  # a controller that cannot be inverted: start on the reference, at rest
        start = {"initial_position": float(problem.experiment.inputs[0, 0]), "initial_velocity": 0.0}
    problems = (problem.keeping({"initial_velocity": 0.0}), problem)
    solver = GaussNewton(tolerance=1e-9, step_tolerance=math.inf, iterations=_STEPS, halvings=0)
    ends = [(p, solve(p, solver, p.vector(start))) for p in problems]
    which, best = min(ends, key=lambda end: float(np.linalg.norm(end[1].residual)))
    return problem.vector(which.values(best.x)), sum(end.evaluations for _, end in ends)


def _compare_tracking(record: Record, run: Simulation, borders: tuple[int, int]) -> float | None:
    """Return the relative error of the simulated tracking error; None without a measured one at the same rate."""
    reference, position = record.reference, record.motor_position
    if reference is None or position is None or position.sample_time != run.sample_time:
        return None
    if reference.sample_time != run.sample_time:
        return None
    size = min(len(reference), len(position), run.motor_position.size)
    asked = reference.values[:size]
    return relative_error(asked - position.values[:size], asked - run.motor_position[:size], borders)
