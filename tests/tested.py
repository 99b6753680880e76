"""The faults that the diagnosis of a joint tests."""

from __future__ import annotations

from jointid.diagnostics.diagnosis import diagnose_joint
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.intervals import rebuild_problem
from jointid.diagnostics.search_state import LoopTests
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Record


def faults_of(estimate: Estimate, record: Record, tests: LoopTests | None = None) -> AxisFaults:
    """Return the faults that were tested of a joint's loop, log and mechanics."""
    return diagnose_joint(estimate, record, rebuild_problem(estimate, record), tests)[0].axes[0].faults
