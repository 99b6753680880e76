"""Which friction a record shows."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from jointid.common.messages import ignore_progress
from jointid.diagnostics import law_comparison
from jointid.diagnostics.law_comparison import compare_laws
from jointid.models.friction import FRICTIONS
from jointid.models.joints import ClosedLoop
from jointid.records.record import Record
from jointid.simulation.loop_input import prepare
from jointid.simulation.synthesis import simulate
from tests.plants import RISES, prismatic, rigid, slow

Axis = tuple[Record, ClosedLoop, dict[str, float]]

compare_frictions = partial(
    compare_laws, kind="friction", filtering=None, parameters=None, didim=None, progress=ignore_progress
)


@pytest.fixture(scope="module")
def rising() -> Axis:
    """A rigid axis of symmetric friction that rises towards standstill, its record, and what it has."""
    case = rigid(prismatic(1))
    loop, values = slow(case, RISES)
    torque = simulate(loop, prepare(loop, case.clean), values).torque
    noise = 0.01 * np.std(torque) * np.random.default_rng(5).standard_normal(torque.size)
    record = replace(case.clean, torque=replace(case.clean.torque, values=torque + noise))
    return record.without("motor_position", "load_position"), loop, values


@pytest.mark.slow
def test_a_rise_is_shown_and_not_the_law_that_has_more_parameters(rising: Axis) -> None:
    record, loop, values = rising
    found = compare_frictions(record, replace(loop, joint=loop.joint.linear))
    assert found.shown.name == "stribeck"
    for name, std in found.shown.std.items():
        assert abs(found.shown.values[name] - values[name]) < 3.5 * std, name
    by_name = {one.name: one for one in found.laws}
    assert set(by_name) == set(FRICTIONS)
    assert by_name["asymmetric-stribeck"].predicts_as_well
    assert not (by_name["symmetric"].predicts_as_well or by_name["asymmetric"].predicts_as_well)
    assert found.answer.code == "another_friction"


@pytest.mark.slow
def test_the_offset_of_a_symmetric_law_is_in_the_coulomb_forces_of_another(
    rising: Axis, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = ("stribeck", "asymmetric-stribeck")
    monkeypatch.setattr(law_comparison, "FRICTIONS", {names[1]: FRICTIONS[names[1]]})  # beside the declared
    laws = {one.name: one for one in compare_frictions(*rising[:2]).laws}
    simple, both = (laws[name] for name in names)
    forwards, backwards = both.values["coulomb_forwards"], both.values["coulomb_backwards"]
    assert 0.5 * (forwards + backwards) == pytest.approx(simple.values["coulomb"], rel=2e-3)
    assert 0.5 * (forwards - backwards) == pytest.approx(3.04, rel=2e-2)  # the offset


@pytest.mark.slow
def test_what_is_kept_of_one_law_is_kept_of_those_that_mean_the_same_by_it(rising: Axis) -> None:
    record, loop, values = rising
    plain = replace(loop, joint=loop.joint.linear)
    offset = next(p for p in plain.joint.parameters if p.name == "offset").fix(values["offset"])
    found = compare_frictions(record, plain, parameters={"offset": offset})
    by_name = {one.name: one for one in found.laws}
    assert found.shown.name == "stribeck"
    both = by_name["asymmetric-stribeck"].values
    assert 0.5 * (both["coulomb_forwards"] - both["coulomb_backwards"]) == pytest.approx(values["offset"], rel=2e-2)
