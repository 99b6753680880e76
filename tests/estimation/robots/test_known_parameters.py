"""Values and bounds that the identification of a robot keeps, by IDIM and by DIDIM."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.common.parameters import Parameter, Quantity
from jointid.estimation.result.verdict import Subject
from tests.estimation.robots.test_several_logs import LOGS, LOOP, TWIN

TRUTH = TWIN.robot.joints[0].viscous


def viscous(free: bool, value: float | None = None, upper: float = np.inf) -> dict[str, Parameter]:
    stated = Parameter("viscous", "Fv", Quantity.VISCOUS, free=free, start=value, lower=0.0, upper=upper)
    return {"joint1.viscous": stated}


@pytest.mark.parametrize("model", [pytest.param(LOOP, marks=pytest.mark.slow), TWIN.robot], ids=["didim", "idim"])
def test_values_and_bounds_are_kept(model: Any) -> None:
    """A bound that holds a parameter speaks against the estimate; one that it does not reach changes nothing."""
    free = ji.identify(LOGS[0], model, checks=False)
    kept = ji.identify(LOGS[0], model, parameters=viscous(free=False, value=TRUTH), checks=False)
    row = kept["joint1.viscous"]
    assert free["joint1.viscous"].free and not row.free and (row.value, row.stderr) == (TRUTH, None)
    assert kept.values["joint1.viscous"] == TRUTH and "joint1.viscous" not in kept.free
    assert row.formula == "Fv1"
    if model is LOOP:  # IDIM fits the friction of the nominal robot, too
        np.testing.assert_array_equal([one.nominal for one in kept.rows], kept.robot.parameters_of(TWIN.robot))
    stderr = [one["joint1.coulomb"].stderr for one in (kept, free)]
    assert stderr[0] < stderr[1], "what is known leaves more for the others"
    low = ji.identify(LOGS[0], model, parameters=viscous(free=True, upper=0.5 * TRUTH))
    assert low.fit.axis_errors["joint1"] > 2 * free.fit.axis_errors["joint1"]
    assert {p.name: p.at_bound for p in low.rows if p.at_bound is not None} == {"joint1.viscous": 0.5 * TRUTH}
    assert low["joint1.viscous"].value == pytest.approx(0.5 * TRUTH)
    assert {one.name: one.passed for one in low.checks}[Subject.BOUNDS] is False
    loose = ji.identify(LOGS[0], model, parameters=viscous(free=True, upper=2 * TRUTH), checks=False)
    assert loose.values == pytest.approx(free.values)


def test_friction_that_differs_by_direction_is_kept_by_its_own_names() -> None:
    first, second = TWIN.robot.joints
    robot = replace(TWIN.robot, joints=(replace(first, coulomb_backwards=first.coulomb), second))
    stated = {f"joint1.{name}": Parameter(name, "", Quantity.FORCE).fix(1.0) for name in
              ("viscous_forwards", "viscous_backwards", "coulomb", "offset")}  # fmt: skip
    kept = ji.identify(LOGS[0], robot, parameters=stated, checks=False)
    assert [name for name, row in kept.parameters.items() if not row.free] == [*stated]
    backwards = {"joint1.coulomb_backwards": Parameter("coulomb", "Fc-", Quantity.FORCE).fix(1.0)}
    for model in (robot, replace(LOOP, robot=robot)):
        with pytest.raises(MethodError):
            ji.identify(LOGS[0], model, parameters=backwards)
