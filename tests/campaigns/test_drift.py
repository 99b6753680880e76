"""The control chart: who drifted is named, and nobody else, however many joints there are."""

import datetime
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest

from jointid.campaigns.campaign import Case
from jointid.campaigns.drift import Series, best_change, judge, series_of
from jointid.campaigns.report import CampaignReport
from jointid.campaigns.run import Found, Outcome, Row
from jointid.common.arrays import FloatArray
from jointid.common.document import Picture
from jointid.output.report.sections import page

STATED = {"stiffness": 0.008, "total_coulomb": 0.017, "total_viscous": 0.025}
"""Stated standard deviation as a share of the value, as the fleet of `examples/fleet` has them."""


def series(values: FloatArray, std: float = 1.0) -> Series:
    days = np.arange(float(values.size))
    labels = tuple(map(str, range(values.size)))
    return Series("axis", (), "stiffness", "N/m", days, values, np.full(values.size, std), labels)


def fleet(
    seed: int, joints: int = 200, days: int = 20, *, scatter: float = 1.3, tail: float = np.inf, falling: int = 0
) -> Iterator[Row]:
    """Yield the rows of a fleet: 5 % are missing, the first joints' stiffness falls by 10 %.

    Args:
        scatter: from run to run, over the stated standard deviation.
        tail: degrees of freedom of its distribution, Student's; few make runs that stand out.
    """
    dice = np.random.default_rng(seed)
    for joint in range(joints):
        own = {name: 1 + 0.1 * dice.uniform(-1, 1) for name in STATED}
        begins = int(dice.integers(days // 3, 2 * days // 3))
        for day in range(days):
            noise = dice.standard_normal(3) if np.isinf(tail) else dice.standard_t(tail, 3)
            stated = {name: share * dice.uniform(0.8, 1.2) for name, share in STATED.items()}
            found = {
                name: Found(own[name] * (1 + scatter * stated[name] * one), own[name] * stated[name], "SI")
                for name, one in zip(STATED, noise, strict=True)
            }
            if joint < falling and day >= begins:
                found["stiffness"] = replace(found["stiffness"], value=0.9 * (found["stiffness"].value or 0.0))
            if dice.random() > 0.05:
                date = datetime.date(2026, 10, 1) + datetime.timedelta(days=day)
                case = Case(f"axis {joint:03}", "", f"{date}.csv", "", date.isoformat())
                yield Row.of(case, Outcome.IDENTIFIED, "", found=found)


def named(rows: Iterator[Row]) -> list[tuple[str, str]]:
    return sorted((one.series.joint, one.series.quantity) for one in judge(series_of(list(rows))) if one.significant)


def test_joints_whose_stiffness_falls_are_named_and_no_others() -> None:
    assert named(fleet(1, 60, falling=3)) == [(f"axis {n:03}", "stiffness") for n in range(3)]
    assert named(fleet(2, 60)) == []


@pytest.mark.slow
@pytest.mark.parametrize(("scatter", "tail"), [(1.3, np.inf), (2.0, np.inf), (1.3, 4.0)])
def test_of_twenty_fleets_without_drift_at_most_one_has_an_alarm(scatter: float, tail: float) -> None:
    alarms = [bool(named(fleet(seed, scatter=scatter, tail=tail))) for seed in range(20)]
    assert sum(alarms) <= 1


@pytest.mark.slow
@pytest.mark.parametrize(("stated", "unlike"), [(0.1, 0.0), (1.0, 0.0), (3.0, 0.0), (0.9, 0.5), (0.5, 1.0)])
def test_the_chance_of_an_alarm_is_not_more_than_it_says(stated: float, unlike: float) -> None:
    """Deviations that are stated too small make no alarms, nor those of which one would weigh nearly all."""
    dice, one, found = np.random.default_rng(4), series(np.zeros(20)), []
    for _ in range(4000):
        values, stds = dice.standard_normal(20), stated * np.exp(unlike * dice.standard_normal(20))
        found.append(best_change(replace(one, values=100.0 + values, stds=stds)).p_value)
    chances = np.array(found)
    assert np.mean(chances < 1e-2) < 1.5e-2 and np.sum(chances < 1e-4) <= 3
    if not unlike:
        assert np.mean(chances < 0.1) <= 0.1 + 3 * np.sqrt(0.1 / chances.size)
    if stated < 1.0:
        assert np.mean(chances < 0.1) > 0.01, "it would see nothing"


def test_a_step_and_a_trend_are_told_with_size_and_day() -> None:
    noise = np.random.default_rng(1).standard_normal(20)
    step = best_change(series(np.where(np.arange(20) < 12, 100.0, 90.0) + noise))
    assert (step.kind, step.since) == ("step", "12")
    assert step.change_percent == pytest.approx(-10.0, abs=2.0)
    assert 0.2 < step.std < 1.0
    trend = best_change(series(100.0 + np.arange(20.0) + 0.3 * noise, 0.3))
    assert (trend.kind, trend.since) == ("trend", "0")
    assert (trend.before, trend.after) == (pytest.approx(100.0, abs=1.0), pytest.approx(119.0, abs=1.0))


def test_one_wild_run_is_no_drift_and_is_named_as_such() -> None:
    values = 100.0 + np.random.default_rng(1).standard_normal(20)
    wild = values.copy()
    wild[-1] = 300.0
    assert list(np.flatnonzero(series(wild).outlying)) == [19]
    before, after = best_change(series(values[:-1])), best_change(series(wild))
    assert after.p_value == before.p_value > 0.01


def test_too_few_runs_and_runs_that_are_all_alike_say_nothing() -> None:
    assert best_change(series(np.ones(7))) is None
    assert best_change(series(np.ones(20))).p_value == 1.0


def report(rows: list[Row]) -> CampaignReport:
    return CampaignReport("line 3", tuple(rows))


def test_a_report_names_who_drifted_what_stands_out_and_what_has_no_answer() -> None:
    rows = list(fleet(1, 30, falling=2))
    rows[100] = wild = replace(rows[100], found=rows[100].found | {"total_coulomb": Found(9.0, 0.1, "SI")})
    rows[200] = aside = replace(rows[200], outcome=Outcome.SET_ASIDE, sentence="2 workers died of it.", found={})
    said = report(rows).summary()
    assert f"{wild.joint}  total_coulomb  {wild.day}" in said
    assert f"{aside.joint} {aside.day}, set aside: 2 workers died of it." in " ".join(said.split())


def test_a_day_that_is_none_does_not_hide_a_drift() -> None:
    values = np.where(np.arange(20) < 10, 100.0, 90.0) + 0.5 * np.random.default_rng(1).standard_normal(20)
    days = [f"2026-02-{number + 10:02}" for number in range(19)] + ["2026-02-30"]
    rows = [
        Row("", "a", "", day, (), Outcome.IDENTIFIED, "", {"stiffness": Found(float(value), 0.5, "N/m")})
        for day, value in zip(days, values, strict=True)
    ]
    (found,) = judge(series_of(rows))
    assert found.significant and found.kind == "step"


def spoilt(rows: list[Row], joint: str, since: str, **more: object) -> list[Row]:
    return [replace(row, **more) if row.joint == joint and row.day >= since else row for row in rows]


def test_a_joint_that_lost_its_value_is_named_and_one_spoilt_day_is_no_loss() -> None:
    """Five days without an answer, and a stiffness that nine days refuse while friction is known."""
    rows = spoilt(list(fleet(1, 12)), "axis 005", "2026-10-16", outcome=Outcome.DOUBTFUL, sentence="It did not end.")
    refused = {"stiffness": Found(None, None, "SI")}
    rows = [replace(row, found=row.found | refused) if row.joint == "axis 009" and row.day > "2026-10-11" else row
            for row in rows]  # fmt: skip
    rows = spoilt(rows, "axis 007", "2026-10-20", outcome=Outcome.REFUSED, sentence="It is empty.", found={})
    lost = report(rows).losses
    assert [(one.joint, one.quantity) for one in lost] == [("axis 005", ""), ("axis 009", "stiffness")]
    assert all(one.last < "2026-10-16" and one.runs >= 4 for one in lost)
    assert report(rows).verdict[1] is False
    assert report(list(fleet(1, 12))).losses == ()
    never = report([replace(row, outcome=Outcome.REFUSED, found={}) for row in rows if row.joint == "axis 001"])
    assert [(one.joint, one.last) for one in never.losses] == [("axis 001", "")]


@pytest.mark.slow
def test_a_page_shows_what_changed() -> None:
    rows = [replace(row, sentence="<script>alert(1)", outcome=Outcome.DOUBTFUL) if row.day > "2026-10-15" else row
            for row in fleet(1, 30, falling=2)]  # fmt: skip
    shown = report(rows).to_document(details=True, pictures=True)
    assert any(isinstance(block, Picture) for block in shown.blocks)
    assert "<script>alert" not in page(shown)
    assert not any(isinstance(block, Picture) for block in report(list(fleet(1, 12))).to_document(pictures=True).blocks)
