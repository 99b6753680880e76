"""Estimates for tests: without their checks, and with some entries of their parts exchanged."""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any, TypeVar

import jointid as ji
from jointid.common.document import Table
from jointid.diagnostics.analysis import rebuild_problem
from jointid.diagnostics.diagnosis import diagnose_joint
from jointid.diagnostics.suspects import AxisFaults
from jointid.estimation.parameters import robot_parameters
from jointid.estimation.problems.simulated import pose_robot
from jointid.estimation.result.estimate import Estimate
from jointid.models.robots.robot import Robot
from jointid.records.record import Record
from jointid.simulation.plant import Numbers

T = TypeVar("T", bound=ji.Estimate)

identify = partial(ji.identify, checks=False)
"""Identify without the checks, which take as long as the identification."""


def amended(estimate: T, **parts: Mapping[str, Any]) -> T:
    """Return an estimate with some entries exchanged: ``amended(estimate, fit={"converged": False})``."""
    return replace(estimate, **{name: replace(getattr(estimate, name), **entries) for name, entries in parts.items()})


def beside_tables(estimate: ji.Estimate) -> dict[str, str]:
    """Return what an answer says beside its first line and its tables: at most four lines, by their names."""
    said = [pair for block in estimate.to_document().blocks if not isinstance(block, Table) for pair in block.pairs]  # type: ignore[union-attr]
    assert len(said) <= 4 and "--details" in said[-1][1]
    return dict(said)


def errors_of_bodies(estimate: ji.Estimate, bodies: Robot, records: Sequence[ji.Record]) -> list[float | None]:
    """Return what a robot leaves of the records of another motion, in the place of the estimate's nominal one."""
    part = estimate.require_robot()
    if estimate.settings.method == "idim":
        there = part.parameters_of(bodies)
        assert there is not None
        rows = [replace(row, nominal=float(one)) for row, one in zip(estimate.rows, there, strict=True)]
        return [axis.nominal_error for axis in ji.validate(replace(estimate, rows=tuple(rows)), records).axes]
    problem: Any = pose_robot(part.setup, records, robot_parameters(part.model), estimate.settings.filtering)
    return [*problem.left_by(Numbers.of(bodies))]


def faults_of(estimate: Estimate, record: Record, **asked: Any) -> AxisFaults:
    """Return the faults that were tested of a joint's loop, log and mechanics."""
    return diagnose_joint(estimate, record, *rebuild_problem(estimate, record), **asked).axes[0].faults
