"""Which spring a record shows."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

import jointid as ji
from jointid.common.errors import MethodError
from jointid.common.messages import ignore_progress
from jointid.diagnostics import law_comparison
from jointid.diagnostics.law_comparison import RIGID, JudgedLaw, LawComparison, compare_laws
from jointid.estimation.methods import didim
from jointid.models.springs import SPRINGS, Spring
from studies.mechanics import spoiled
from tests.plants import Case, cut, prismatic, with_spring
from tests.rigid_axis import LOOP, recorded

compare_springs = partial(
    compare_laws, kind="spring", filtering=None, parameters=None, didim=None, progress=ignore_progress
)


@pytest.fixture(scope="module")
def plain() -> tuple[Case, LawComparison]:
    case = prismatic(1)
    record = cut(case.clean, 0, 4000)
    noise = 0.02 * np.std(record.torque.values) * np.random.default_rng(2).standard_normal(4000)
    record = replace(record, torque=replace(record.torque, values=record.torque.values + noise))
    with pytest.MonkeyPatch.context() as patch:
        judging(patch, "linear", "backlash", "three-piece")  # the fewest parameters, and the most
        return case, compare_springs(record, case.loop, didim=ji.DIDIM(frequency=case.mode))


def test_what_is_kept_from_a_fit_is_predicted_worse_than_what_is_fitted(plain: tuple[Case, LawComparison]) -> None:
    _, found = plain
    assert all(one.kept > 0.97 * one.fitted for one in found.laws)
    more = {one.name: one.kept - one.fitted for one in found.laws}
    assert more["three-piece"] > more["linear"]


def judging(monkeypatch: pytest.MonkeyPatch, *names: str) -> None:
    """Judge these springs alone, the rigid joint beside them."""
    monkeypatch.setattr(law_comparison, "SPRINGS", {name: SPRINGS[name] for name in names})


@pytest.mark.slow
def test_a_rigid_axis_shows_no_spring(monkeypatch: pytest.MonkeyPatch) -> None:
    judging(monkeypatch, "linear", "backlash", "three-piece")  # the fewest parameters, and the most
    found = compare_springs(recorded(0.5, seed=3), replace(LOOP, joint=ji.FlexibleJoint("prismatic")))
    assert found.shown.name == RIGID
    assert found.answer.code == "no_spring"


def one(name: str, parameters: int, worse: float, error: float) -> JudgedLaw:
    return JudgedLaw(name, parameters, {}, {}, 0.01, 0.01, worse, error)


@pytest.mark.parametrize(("worse", "shown"), [(0.5, "backlash"), (0.29, "linear")])
def test_the_simplest_of_those_that_predict_alike_is_shown(worse: float, shown: str) -> None:
    laws = (one("linear", 2, worse, 0.1), one("backlash", 3, 0.25, 0.1), one("two-piece", 4, 0.0, 0.0))
    assert LawComparison("spring", laws, "linear").shown.name == shown


@pytest.mark.slow
def test_a_law_that_cannot_be_identified_is_left_out(
    plain: tuple[Case, LawComparison], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: object) -> None:
        raise MethodError("The loop runs away.")

    monkeypatch.setattr(didim, "from_linear_laws", fail)
    case, _ = plain
    found = compare_springs(cut(case.clean, 0, 2000), case.loop, didim=ji.DIDIM(frequency=case.mode))
    assert found.shown.name == "linear"
    assert [one.name for one in found.laws] == [RIGID, "linear"]


@pytest.mark.slow
def test_what_is_declared_of_one_law_is_not_taken_for_another_s(
    plain: tuple[Case, LawComparison], monkeypatch: pytest.MonkeyPatch
) -> None:
    judging(monkeypatch, "linear")  # and the declared one, which a table may lack
    case, _ = plain
    record, given = cut(case.clean, 0, 3000), {p.name: p for p in case.loop.joint.parameters}
    declared = {"stiffness": given["stiffness"].fix(0.5 * case.truth["stiffness"]), "offset": given["offset"].fix(0.0)}
    loop = with_spring(case.loop, Spring("two-piece"))
    found = compare_springs(record, loop, parameters=declared, didim=ji.DIDIM(frequency=case.mode))
    by_name = {one.name: one for one in found.laws}
    assert "stiffness" not in by_name["two-piece"].std  # which is kept
    assert by_name["linear"].values["stiffness"] == pytest.approx(case.truth["stiffness"], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fault", "spring"), [("none", "linear"), ("backlash", "backlash"), ("spring in pieces", "three-piece")]
)
def test_the_spring_of_another_simulator_is_shown(fault: str, spring: str) -> None:
    made = spoiled(0, fault, 8.0)
    found = compare_springs(made.record, made.axis.loop)
    assert found.shown.name == spring
    assert [one.name for one in found.laws] == [RIGID, *sorted(SPRINGS, key=lambda name: len(SPRINGS[name].parameters))]


def test_what_cannot_be_compared_is_refused(plain: tuple[Case, LawComparison]) -> None:
    case, _ = plain
    for record, asked in (
        (case.clean, {"parameters": {"stifness": case.loop.joint.parameters[3]}}),
        (cut(case.clean, 0, 600), {"didim": ji.DIDIM(frequency=case.mode)}),
    ):
        with pytest.raises(MethodError):
            compare_springs(record, case.loop, **asked)
