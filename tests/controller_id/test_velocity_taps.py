"""A velocity that is a weighted difference: its taps found by one regression, named where they have a name."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid import to_dict
from jointid.config import load, save_with_controller
from jointid.controller_id.fitting import FittedLaw, Task, fit
from jointid.controller_id.learn import learn_controller
from jointid.controller_id.learned_controller import LearnedController
from jointid.controller_id.limitations import LimitationCode
from jointid.controller_id.loop_record import prepare_loop_record
from jointid.controller_id.noise import Noise
from jointid.controller_id.ranking import Rival, much_simpler
from jointid.controller_id.regression import (
    Regression,
    RegressionFit,
    Weighting,
    compare_with_regression,
    initial_weighting,
    law_numbers,
    regression,
)
from jointid.controller_id.search import _SearchData, _shorten_taps
from jointid.controller_id.structure_moves import list_neighbours, list_simpler
from jointid.controller_id.structures import (
    FREE_TAPS,
    NumberedStructure,
    Structure,
    controller,
    convert_numbers,
    filters_of,
    list_known_taps,
)
from jointid.records.record import Record
from studies.learned import loop_twin
from tests.controller_id.servos import TapsTwin, taps_twin
from tests.mistakes import cut

EMPS = load(Path(__file__).resolve().parents[2] / "examples" / "emps" / "joint.toml")


def law_of(twin: TapsTwin, velocity_filter: str) -> Structure:
    """The true law of a servo, with a velocity filter."""
    tracked = twin.controller.reference_velocity == "difference"
    like = Structure("PD", "difference") if tracked else Structure("P-P")
    return replace(like, velocity_filter=velocity_filter)


def numbers_of(twin: TapsTwin, structure: Structure) -> dict[str, float]:
    """The true numbers, in the words of a structure."""
    law = twin.controller
    gains = {"position_gain": law.position_gain, "derivative_gain": law.derivative_gain}
    return convert_numbers(structure, gains | {f"velocity_filter.{i}": h for i, h in enumerate(twin.taps)})


def on_own_noise(on: Regression, structure: Structure) -> tuple[RegressionFit, Weighting]:
    weighting = initial_weighting(on)
    for _ in range(3):
        found = on.fit_gains(structure, {}, weighting, free=False)[0]
        weighting = on.weighting(found)
    return found, weighting


@pytest.mark.parametrize(
    ("seed", "law"),
    [(1, Structure("PD", "difference")), (1, Structure("P-P", "share")), (4, Structure("P-PI"))],
    ids=["PD", "P-P", "P-PI"],
)
def test_a_regression_finds_all_taps_and_predicts_what_the_law_does(seed: int, law: Structure) -> None:
    twin = taps_twin(seed)
    task, structure = Task(prepare_loop_record(twin.record), 1.0), replace(law, velocity_filter=FREE_TAPS)
    on = regression(task.log)
    given = {"integral_gain": 3.0} if law.integrates else {}
    found = on.fit_gains(structure, given, initial_weighting(on), free=False)[0]
    numbers = law_numbers(found, 1.0)
    assert tuple(numbers) == structure.names
    difference = task.residual(structure, numbers) * on.kept - found.residual
    assert np.std(difference[60:]) < 1e-8 * np.std(task.log.torque)
    if law.law == "PD":
        taps = filters_of(structure, numbers)[0]
        assert isinstance(taps, tuple)
        assert taps == pytest.approx((*twin.taps, *(0.0,) * (8 - len(twin.taps))), abs=5e-3)


def test_a_difference_that_has_a_name_is_called_by_it() -> None:
    weights = {kind: filters_of(Structure(velocity_filter=kind), {})[0] for kind in list_known_taps()}
    assert weights["slope 3"] == pytest.approx((0.3, 0.4, 0.3))
    assert weights["means 2 3"] == pytest.approx((1 / 6, 1 / 3, 1 / 3, 1 / 6))
    for kind, taps in weights.items():
        assert isinstance(taps, tuple)
        assert sum(taps) == pytest.approx(1.0), kind
        line = np.arange(len(taps) + 1) * 3.0  # the speed of a straight motion
        assert np.dot(taps, -np.diff(line[::-1])) == pytest.approx(3.0)
    # The line of least squares through the last positions, the newest first.
    assert weights["slope 5"] == pytest.approx(np.cumsum([-np.polyfit(range(6), e, 1)[0] for e in np.eye(6)])[:-1])
    assert str(Structure("PD", "difference", "slope 5")).endswith("velocity filter line through 6 positions")
    simpler = {one.velocity_filter for one in list_simpler(Structure("PD", "difference", "taps 4"))}
    assert simpler >= {"taps 3", "mean 4", "slope 4", "means 2 3"}
    assert FREE_TAPS in {one.velocity_filter for one in list_neighbours(Structure(), channel=False)}


@pytest.mark.parametrize("seed", [1, 3, 5, 7])
def test_as_many_taps_as_the_velocity_has(seed: int) -> None:
    twin = taps_twin(seed)
    task = Task(prepare_loop_record(twin.record), 1.0)
    data = _SearchData(task, replace(regression(task.log), own=True))
    found, weighting = on_own_noise(data.regression, law_of(twin, FREE_TAPS))
    (shortened,) = _shorten_taps(data, [NumberedStructure(found.structure, {}, found.cost)], weighting)
    structure = shortened.structure
    if len(twin.taps) == 1:
        assert structure.velocity_filter == "taps 2"
        return
    numbers = law_numbers(data.regression.fit_gains(structure, {}, weighting, free=False)[0], 1.0)
    taps = filters_of(structure, numbers)[0]
    assert isinstance(taps, tuple) and len(taps) == len(twin.taps)
    assert taps == pytest.approx(twin.taps, abs=5e-3)


def test_taps_that_cancel_each_other_are_none() -> None:
    """Where a coarse encoder hides the taps, wild ones would react to its rounding alone."""
    twin = taps_twin(0)
    task = Task(prepare_loop_record(twin.record), 1.0).select_strongest(4000)
    data = _SearchData(task, replace(regression(task.log), own=True))
    found, weighting = on_own_noise(data.regression, law_of(twin, FREE_TAPS))
    assert sum(abs(value) for value in found.numbers.values()) > 5.0
    assert data.to_law(found, weighting.noise) is None
    (shortened,) = _shorten_taps(data, [NumberedStructure(found.structure, {}, found.cost)], weighting)
    assert data.fit_gains(shortened.structure, {}, weighting) is not None
    assert shortened.structure.taps < 4


def test_feed_forwards_that_are_not_there_do_not_hide_the_difference() -> None:
    """One of them comes out negative, and all are taken away later; and the 7 free taps weigh more than a filter."""
    twin = taps_twin(111)
    task = Task(prepare_loop_record(twin.record), 1.0)
    data = _SearchData(task, replace(regression(task.log), own=True))
    law = replace(law_of(twin, FREE_TAPS), feedforward=frozenset({"acceleration", "coulomb", "constant"}))
    found, weighting = on_own_noise(data.regression, law)
    assert any(law_numbers(found, 1.0)[name] < 0 for name in ("acceleration_feedforward", "coulomb_feedforward"))
    plain = NumberedStructure(law, {}, found.cost)
    filtered = NumberedStructure(replace(law, velocity_filter="second order"), {}, found.cost + 20.0)
    delayed = NumberedStructure(replace(law, reference_delay=True), {"reference_delay": 3e-3}, found.cost - 1.0)
    given = _shorten_taps(data, [delayed, filtered, plain], weighting)
    assert [one.structure.velocity_filter for one in given] == ["slope 8", "slope 8", "second order"]


def test_of_laws_alike_a_much_simpler_one_is_taken() -> None:
    """Where the encoder hides a filter, a law of many parts explains a little of its steps."""
    noise = Noise(1.0, 0.0, np.ones(3))
    plain, filtered, wild = (
        FittedLaw(one, {}, 1.0, noise)
        for one in (
            Structure(velocity_filter="mean 7"),
            Structure(velocity_filter="first order"),
            Structure("P-P", "share", "second order", frozenset({"acceleration"})),
        )
    )
    assert much_simpler(wild, [Rival(filtered, 1.0, 0.01), Rival(plain, 7.0, 0.01)]) is plain
    assert much_simpler(wild, [Rival(plain, 12.0, 0.01)]) is None  # that one is ruled out
    assert much_simpler(filtered, [Rival(plain, 7.0, 0.01)]) is None


def test_a_plain_regression_measures_the_law() -> None:
    twin = taps_twin(1)
    task = Task(prepare_loop_record(twin.record), 1.0)
    for kind, another in ((f"taps {len(twin.taps)}", False), ("mean 2", True)):
        structure = law_of(twin, kind)
        beside = compare_with_regression(task.log, task.residual(structure, numbers_of(twin, structure)))
        assert beside.another is another, kind
        assert 0.5e-3 < beside.regression < 2e-3


@pytest.mark.parametrize("seed", [0, 4, 8, 12, 14, 21])
def test_no_true_law_leaves_much_more_than_a_plain_regression(seed: int) -> None:
    twin = loop_twin(seed)
    task = Task(prepare_loop_record(twin.record), 1.0)
    assert not compare_with_regression(task.log, task.residual(twin.structure, twin.numbers)).another


def learned_as(twin: TapsTwin, kind: str, monkeypatch: pytest.MonkeyPatch) -> LearnedController:
    """What is told of a law that a search found."""

    def found(task: Task, *_: object) -> tuple[FittedLaw, tuple[()], bool]:
        structure = law_of(twin, kind)
        begun = numbers_of(twin, structure)
        law = fit(task, structure, begun, task.noise(structure, begun))
        assert law is not None
        return law, (), True

    monkeypatch.setattr("jointid.controller_id.learn.search", found)
    return learn_controller(twin.record)


def test_what_a_wrong_law_leaves_is_not_called_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    twin = taps_twin(1)
    true, wrong = (learned_as(twin, kind, monkeypatch) for kind in ("taps 4", "mean 2"))
    assert not true.another_law and "noise of the torque" in str(true)
    assert wrong.another_law and "noise of the torque" not in str(wrong)
    assert " ".join(str(wrong).split()).count("is no noise") == 1
    assert wrong.limitations[0].code is LimitationCode.ANOTHER_LAW
    assert "a plain regression" in wrong.sentence and "is no noise" in wrong.sentence
    assert to_dict(wrong)["regression_percent"] == pytest.approx(0.1, rel=0.1)


def test_free_taps_have_intervals_and_go_into_a_joint_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    twin = taps_twin(1)
    learned = learned_as(twin, "taps 4", monkeypatch)
    for i, tap in enumerate(twin.taps[1:], 1):
        one = learned[f"velocity_filter.{i}"]
        assert abs(one.value - tap) < 4 * one.std < 0.02 and one.unit == ""
    save_with_controller(EMPS, learned.controller, tmp_path / "joint.toml")
    assert load(tmp_path / "joint.toml").controller == learned.controller
    built = controller(learned.structure, {one.name: one.value for one in learned.numbers}, 1e-3, 1.0)
    assert built == learned.controller


@pytest.mark.slow
def test_the_search_for_taps_finds_no_taps_where_there_are_none() -> None:
    record: Record = cut(taps_twin(3).record, 2.5)  # a plain difference
    learned = learn_controller(record)
    assert learned.structure.velocity_filter == "none" and "feed-forward" not in str(learned.structure).replace(
        "full velocity feed-forward", ""
    )
