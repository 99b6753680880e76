"""Diagnosis of the axes of an estimate: of each its residual, its controller and its faults.

Each axis' residual is tested for whiteness, and each controller by the torque that it makes of the logged position.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import TypeAlias

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.diagnostics.axis_faults import find_axis_faults, find_driving_axes
from jointid.diagnostics.axis_laws import find_filled_references
from jointid.diagnostics.axis_torques import AxisTorques, torques_of_loop, torques_of_robot
from jointid.diagnostics.check_loop import list_laws, search_faults
from jointid.diagnostics.diagnosis import AxisDiagnosis, Diagnosis
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.model_free import LawOnPosition, compare_law, compare_robot_laws
from jointid.diagnostics.robot_causes import find_copied_reference, find_robot_cause, find_wrong_sign
from jointid.diagnostics.search_state import LoopTests, SearchState
from jointid.diagnostics.variants import OTHER_LAWS
from jointid.estimation.problems.closed_loop import ClosedLoopProblem
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers import Controller
from jointid.models.controllers.servo_base import require_one_each
from jointid.models.joints import FlexibleJoint
from jointid.records.record import Record
from jointid.simulation.controller_torque import SOURCE
from jointid.simulation.robots import RobotLoop
from jointid.uncertainty.position_dependent_error import cells, repeatable
from jointid.uncertainty.residual_tests import whiteness

_NEARLY_ALL = 0.8  # of the squares of all axes that are not explained

Solved: TypeAlias = tuple[ClosedLoopProblem, FloatArray]
"""The closed-loop problem of a joint, and its solution, (free,)."""


def diagnose_joint(
    estimate: Estimate,
    record: Record,
    solved: Solved,
    tests: LoopTests | None = None,
) -> tuple[Diagnosis, SearchState]:
    """Diagnose the estimate of a joint by DIDIM.

    Args:
        estimate: by DIDIM, of this record.
        record: that it was identified from.
        solved: its problem; the parameters identified beside the joint are not tested.
        tests: settings of the tests.

    Returns:
        The diagnosis, and the problem with the faults that were found corrected.
    """
    problem, x = solved
    std = {p.name: p.stderr for p in estimate.params.rows if p.stderr is not None}
    law = compare_law(record, problem.loop)
    faults, state = search_faults(problem, x, tests, std, record, law)
    torques, residuals = torques_of_loop(problem, x), estimate.fit.residuals
    axis = _diagnose_axis(
        "", 0, torques, law, faults,
        None if residuals is None or (found := residuals.repeatable) is None or found.p_value is None
        else found.significant,
    )  # fmt: skip
    return Diagnosis(record.name, estimate.settings.method, (axis,), torques), state


def diagnose_robot(
    estimate: Estimate,
    records: Sequence[Record],
    controllers: Sequence[Controller | None] = (),
) -> Diagnosis:
    """Diagnose the estimate of a robot by any method.

    Args:
        estimate: of these records.
        records: of each joint.
        controllers: of each joint as declared, None where one is not known; those of the estimate's loop if none are
            given.
    """
    part = estimate.require_robot()
    robot, torques = part.model, torques_of_robot(estimate, records)
    if not controllers and isinstance(part.setup, RobotLoop):
        controllers = part.setup.controllers
    require_one_each(controllers, len(robot))
    laws = compare_robot_laws(robot, records, controllers)
    units = [(robot.position_unit(k), robot.torque_unit(k)) for k in range(len(robot))]
    own = [
        list_laws(FlexibleJoint(link.kind, joint.law), linear=True)
        for link, joint in zip(robot.links, robot.joints, strict=True)
    ]
    faults, explained = find_axis_faults(torques, units, LoopTests().level, own)
    axes = tuple(
        _diagnose_axis(
            name, k, torques, laws[k], faults[k], _repeats(torques, k) if _is_seen_through_law(record) else None
        )
        for k, (name, record) in enumerate(zip(robot.names, records, strict=True))
    )  # fmt: skip
    cause = find_copied_reference(robot, records) or find_wrong_sign(robot.names, find_driving_axes(torques))
    if cause is None and isinstance(part.setup, RobotLoop) and part.setup.controllers:
        left = {one.name: one.left for one in axes}
        cause = find_filled_references(part.setup, records, estimate.settings.filtering, left)
    # DIDIM and the drive side take a wrong model for another robot: their search ends elsewhere.
    local = any(one.part is not None for one in faults)
    large = sum(not one.is_small for one in axes)
    if cause is None and estimate.settings.method == "idim" and large:
        cause = find_robot_cause(robot, records, estimate.settings.filtering)
    # What acts all the time explains a part of it only where it explains nearly everything.
    least = max(explained, _NEARLY_ALL * large) if local else explained
    if cause is not None and cause.explained > least:
        axes = tuple(map(_wait_for_cause, axes))
    else:
        cause = None
    return Diagnosis(robot.name, estimate.settings.method, axes, torques, cause)


def _wait_for_cause(axis: AxisDiagnosis) -> AxisDiagnosis:
    """Return an axis without the faults that a cause explains; how its controller reads the reference is none."""
    laws = tuple(one for one in axis.faults.findings if one.test.name in OTHER_LAWS)
    return replace(axis, faults=replace(axis.faults, findings=laws, undecided=None), caused=True)


def _is_seen_through_law(record: Record) -> bool:
    """Test whether a torque is computed from the controller, at some frequencies at least: its noise is coloured."""
    return record.torque is not None and record.torque.source.endswith(SOURCE)


def _repeats(torques: AxisTorques, axis: int) -> bool | None:
    """Test whether the residual of an axis repeats with its motion; None where too little was visited twice."""
    inside = torques.seen[axis]
    where = cells(torques.position[axis][inside], torques.velocity[axis][inside])
    found = repeatable(torques.error[axis][inside], where)
    return None if found.p_value is None else found.significant


def _diagnose_axis(
    name: str,
    axis: int,
    torques: AxisTorques,
    law: LawOnPosition | None,
    faults: AxisFaults,
    repeats: bool | None = None,
) -> AxisDiagnosis:
    """Return the diagnosis of one axis."""
    inside, whole = torques.seen[axis], float(np.linalg.norm(torques.measured[axis])) or 1.0
    return AxisDiagnosis(
        name,
        float(np.linalg.norm(torques.error[axis])) / whole,
        whiteness(torques.error[axis][inside], torques.sample_time, torques.cutoff),
        law,
        faults,
        repeats,
    )
