"""How well a record tells a parameter."""

from dataclasses import replace

import pytest

import jointid as ji
from jointid.diagnostics.axis_parameters import Told, parameters_by_axis
from studies.unknown_timing import logged


@pytest.mark.parametrize(("share", "known"), [(0.05, Told.TOLD), (0.45, Told.ROUGHLY), (0.55, Told.NOT)])
def test_a_value_whose_interval_holds_0_is_not_told_roughly(share: float, known: Told) -> None:
    found = ji.identify(logged(50.0, True, 1)[0], ji.RigidJoint("revolute"), ji.IDIM(), checks=False)
    rows = tuple(replace(row, stderr=share * abs(row.value or 0.0)) for row in found.params.rows)
    changed = replace(found, params=replace(found.params, rows=rows))
    assert {one.known for one in parameters_by_axis(changed)} == {known}
