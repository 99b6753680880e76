"""Profiles and bootstraps of an estimate, as a user asks for them."""

from __future__ import annotations

import pytest

from jointid.common.errors import MethodError
from jointid.diagnostics.intervals import intervals, require_quantities
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.models.joints import ClosedLoop, RigidJoint
from jointid.paper.twin import twin
from jointid.records.record import Record
from tests.estimates import identify
from tests.estimation.conftest import CONTROLLER

AXIS = twin(noise="white", seed=4)
RECORD = AXIS.record.without("motor_position", "load_position")


@pytest.fixture(scope="module")
def estimate():  # type: ignore[no-untyped-def]
    return identify(RECORD, AXIS.loop)


@pytest.mark.slow
def test_profiles_agree_with_the_table_where_the_criterion_is_a_parabola(estimate) -> None:  # type: ignore[no-untyped-def]
    found = intervals(estimate, RECORD, ["stiffness", "compliance", "motor_viscous + load_viscous"])
    stiffness, compliance, total = found.profiles
    low, high = (1 / (end or 1.0) for end in reversed(compliance.interval))
    for profile, value, std in (
        (stiffness, estimate.values["stiffness"], estimate["stiffness"].stderr),
        (total, *estimate.params.total(("motor_viscous", "load_viscous"))),
    ):
        assert profile.bounded
        assert profile.interval[0] == pytest.approx(value - 2 * std, abs=0.2 * std)
        assert profile.interval[1] == pytest.approx(value + 2 * std, abs=0.2 * std)
    assert (low, high) == pytest.approx(stiffness.interval, rel=1e-3)


def test_bootstraps_agree_with_the_table(estimate) -> None:  # type: ignore[no-untyped-def]
    found = intervals(estimate, RECORD, bootstrap=True)
    for one in (found.over_time, found.over_place):
        assert one is not None
        names = [p.name for p in one.parameters]
        for name in ("motor_inertia", "load_inertia", "stiffness"):
            assert one.std[names.index(name)] == pytest.approx(estimate[name].stderr, rel=0.4)
    assert "1000 draws" in str(found)


def test_on_emps_the_bootstrap_over_place_sees_what_repeats(emps: Record) -> None:
    loop = ClosedLoop(RigidJoint("prismatic"), CONTROLLER)
    found = intervals(identify(emps, loop, DIDIM()), emps, bootstrap=True)
    assert found.over_time is not None
    assert found.over_place is not None
    viscous = [p.name for p in found.over_time.parameters].index("viscous")
    assert found.over_place.std[viscous] > 2 * found.over_time.std[viscous]


def test_what_cannot_be_followed_is_said(estimate, emps: Record) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(MethodError, match='"colour" is no quantity of this estimate; name a free parameter'):
        intervals(estimate, RECORD, ["colour"])
    with pytest.raises(MethodError, match="adds N and N s/m; only what has one unit can be added"):
        intervals(estimate, RECORD, ["motor_viscous + load_coulomb"])
    with pytest.raises(MethodError, match="This record is not the one the estimate came from"):
        intervals(estimate, twin(noise="white", seed=5).record, ["stiffness"])
    with pytest.raises(MethodError, match="Profiles and bootstraps are of DIDIM"):
        intervals(identify(AXIS.record, AXIS.loop, IDIM()), AXIS.record, ["stiffness"])


def test_what_no_estimate_can_have_is_refused_before_one_is_made() -> None:
    require_quantities(
        ["stiffness", "compliance", "motor_viscous - load_viscous", "position_gain", "log_delay"], AXIS.loop
    )
    with pytest.raises(MethodError, match=r'"stifness" is no quantity of this estimate; .*, or compliance'):
        require_quantities(["stiffness", "stifness"], AXIS.loop)
    with pytest.raises(MethodError, match='"" is no quantity'):
        require_quantities([""], AXIS.loop)
    with pytest.raises(MethodError, match=r'"compliance" is no quantity .* sum or difference of some\.'):
        require_quantities(["compliance"], ClosedLoop(RigidJoint("prismatic"), CONTROLLER))
