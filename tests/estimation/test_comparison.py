"""Every method side by side."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.common.errors import RecordError
from jointid.diagnostics.compare import MethodComparison, compare
from jointid.estimation.methods.didim import DIDIM
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.output import json as answers
from jointid.paper.twin import twin
from jointid.records.record import Record
from tests.estimation.conftest import CONTROLLER
from tests.text import unwrapped


@pytest.fixture(scope="module")
def flexible() -> MethodComparison:
    axis = twin()
    return compare(axis.record, axis.loop, didim=DIDIM(frequency=30.0))


@pytest.mark.slow
def test_every_method_that_can_run_has_run(flexible: MethodComparison) -> None:
    names = ["DIDIM", "IDIM-LS", "IDIM-WLS", "IDIM-IRLS", "IDIM-IV", "DIDIM asymmetric", "IDIM-LS asymmetric"]
    assert [method.name for method in flexible.methods] == names
    assert list(flexible.estimates) == names
    assert flexible.estimates["DIDIM"].data.channels == ("torque", "reference", "injected")
    assert all(method.seconds > 0 for method in flexible.methods)


def test_a_disagreement_is_pointed_out(flexible: MethodComparison) -> None:
    """The disturbance in the loop has moved least squares; its intervals cover that, and instruments say so."""
    off = flexible.estimates["IDIM-LS"]["motor_inertia"].value - flexible.estimates["DIDIM"]["motor_inertia"].value
    assert abs(off) < 2 * flexible.estimates["IDIM-LS"]["motor_inertia"].stderr
    assert not any("on motor inertia" in line or "on stiffness" in line for line in flexible.disagreements)
    text = str(flexible)
    assert "IDIM-IV, Durbin-Wu-Hausman: IDIM's regressors are correlated with its errors" in unwrapped(text)
    rows = [line for line in text.splitlines() if line.startswith("motor inertia")]
    assert sum(row.count("±") for row in rows) == 7
    assert max(map(len, text.splitlines())) <= 80


def test_what_cannot_run_is_listed_with_the_reason(emps: Record) -> None:
    found = compare(emps.without("motor_position"), ClosedLoop(RigidJoint("prismatic"), CONTROLLER))
    assert list(found.estimates) == ["DIDIM", "DIDIM asymmetric"]
    assert "IDIM-LS cannot run: IDIM needs motor_position; this record has torque, reference" in unwrapped(str(found))
    assert found.disagreements == ()
    assert "no parameter differs between methods by more than their intervals allow" in unwrapped(str(found))
    alone = compare(emps, RigidJoint("prismatic"))
    assert list(alone.estimates) == ["IDIM-LS", "IDIM-IRLS", "IDIM-LS asymmetric"]
    assert "DIDIM cannot run: DIDIM simulates the closed loop, so it needs the controller" in str(alone)
    fixed = compare(
        emps, RigidJoint("prismatic"), parameters={"viscous": RigidJoint("prismatic").parameters[1].fix(207.0)}
    )
    assert fixed.estimates["IDIM-LS"].values["viscous"] == 207.0
    assert fixed.estimates["IDIM-LS asymmetric"].values["viscous_forwards"] == pytest.approx(171, abs=1)


def test_a_record_that_cannot_be_is_refused_at_once(emps: Record) -> None:
    assert emps.torque is not None
    still = replace(emps, torque=replace(emps.torque, values=np.full(len(emps.torque), 3.0)))
    with pytest.raises(RecordError, match="The torque is 3 N in every sample"):
        compare(still, RigidJoint("prismatic"))


def test_the_answer_is_written(flexible: MethodComparison, tmp_path: Path) -> None:
    answers.write(answers.to_dict(flexible), tmp_path / "out.json")
    answer = json.loads((tmp_path / "out.json").read_text(encoding="utf-8"))
    assert answer["schema"] == "jointid.comparison/1"
    assert answer["methods"][4]["estimate"]["tests"][0]["rejected"] is True
    assert answer["methods"][0]["refusal"] == ""
    assert answer["disagreements"] == list(flexible.disagreements)
    page = (Path(__file__).resolve().parents[2] / "docs" / "answers.md").read_text(encoding="utf-8")
    assert all(f"`{key}`" in page for key in answer)
