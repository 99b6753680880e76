"""Values and bounds that the identification of a robot keeps, by IDIM and by DIDIM."""

from dataclasses import replace

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


def test_didim_keeps_values_and_bounds() -> None:
    free = ji.identify(LOGS[0], LOOP, checks=False)
    kept = ji.identify(LOGS[0], LOOP, parameters=viscous(free=False, value=TRUTH))
    row = kept["joint1.viscous"]
    assert free["joint1.viscous"].free and not row.free and (row.value, row.stderr) == (TRUTH, None)
    assert kept.values["joint1.viscous"] == TRUTH and "joint1.viscous" not in kept.free
    assert (row.nominal, row.formula) == (pytest.approx(TRUTH), "Fv1")
    np.testing.assert_array_equal([one.nominal for one in kept.rows], kept.robot.parameters_of(TWIN.robot))
    (shown,) = (line.split() for line in kept.summary().splitlines() if line.startswith("joint1, viscous "))
    assert "fixed" in " ".join(shown)
    stderr = [one["joint1.coulomb"].stderr for one in (kept, free)]
    assert stderr[0] < stderr[1], "what is known leaves more for the others"
    low = ji.identify(LOGS[0], LOOP, parameters=viscous(free=True, upper=0.5 * TRUTH))
    assert low["joint1.viscous"].value == pytest.approx(0.5 * TRUTH)
    assert low.fit.axis_errors["joint1"] > 2 * free.fit.axis_errors["joint1"]
    require_held(low, "joint1.viscous")


def require_held(found: ji.Estimate, name: str) -> None:
    """Require that the bound of a parameter, and of no other, speaks against the estimate."""
    assert {p.name: p.at_bound for p in found.rows if p.at_bound is not None} == {name: 0.5 * TRUTH}
    assert {one.name: one.passed for one in found.checks}[Subject.BOUNDS] is False


def test_idim_keeps_values_and_bounds() -> None:
    free = ji.identify(LOGS[0], TWIN.robot)
    kept = ji.identify(LOGS[0], TWIN.robot, parameters=viscous(free=False, value=TRUTH))
    low = ji.identify(LOGS[0], TWIN.robot, parameters=viscous(free=True, upper=0.5 * TRUTH))
    loose = ji.identify(LOGS[0], TWIN.robot, parameters=viscous(free=True, upper=2 * TRUTH))
    assert (kept["joint1.viscous"].value, low["joint1.viscous"].value) == (TRUTH, 0.5 * TRUTH)
    assert loose.values == free.values and not kept["joint1.viscous"].free
    assert low.fit.axis_errors["joint1"] > 2 * free.fit.axis_errors["joint1"]
    require_held(low, "joint1.viscous")


def test_friction_that_differs_by_direction_is_kept_by_its_own_names() -> None:
    first, second = TWIN.robot.joints
    robot = replace(TWIN.robot, joints=(replace(first, coulomb_backwards=first.coulomb), second))
    stated = {f"joint1.{name}": Parameter(name, "", Quantity.FORCE).fix(1.0) for name in
              ("viscous_forwards", "viscous_backwards", "coulomb", "offset")}  # fmt: skip
    kept = ji.identify(LOGS[0], robot, parameters=stated, checks=False)
    assert [name for name, row in kept.parameters.items() if not row.free] == [
        "joint1.viscous_forwards",
        "joint1.viscous_backwards",
        "joint1.coulomb",
        "joint1.offset",
    ]
    backwards = {"joint1.coulomb_backwards": Parameter("coulomb", "Fc-", Quantity.FORCE).fix(1.0)}
    for model in (robot, replace(LOOP, robot=robot)):
        with pytest.raises(MethodError):
            ji.identify(LOGS[0], model, parameters=backwards)
