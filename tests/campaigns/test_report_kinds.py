"""The report takes repeated runs, searches and sweeps for what they are: no control chart where there is no time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from jointid.campaigns.cases import Case, Found, Outcome, Redrawn, Row, Simulated, Started
from jointid.campaigns.folder import Results
from jointid.campaigns.report import CampaignReport
from jointid.campaigns.run_groups import ends_of, repeats_of


def made(varied: Simulated | Redrawn | Started | None, value: float, *changes: str, error: float = 8.0) -> Row:
    """Return a row whose stiffness is 100 of a deviation of 1, plus `value`."""
    found = {"stiffness": Found(100 + value, 1.0, "N/m"), "offset": Found(2.0, None, "N")}
    case = Case("axis", "", "run.npy", "", "2026-11-23", changes, varied)
    return Row.of(case, Outcome.IDENTIFIED, "", found=found, error_percent=error)


def simulated(count: int, scale: float = 1.0, *changes: str, shift: float = 0.0) -> list[Row]:
    noise = scale * np.random.default_rng(4).standard_normal(count) + shift
    return [made(Simulated((), seed=seed), float(value), *changes) for seed, value in enumerate(noise)]


def report(rows: list[Row]) -> CampaignReport:
    return CampaignReport(Results("runs", len(rows), tuple(rows), tuple(map(float, range(len(rows))))))


def flat(found: CampaignReport) -> str:
    return " ".join(found.to_document(details=True).text().split())


def test_repeated_runs_have_no_drift_even_where_their_values_climb_with_the_seed() -> None:
    rows = [made(Redrawn(seed), 0.3 * seed) for seed in range(40)]
    assert report(rows).changes == report(rows).drifted == ()
    said = flat(report(rows))
    assert "drift" not in said.lower() and "since" not in said
    assert report([replace(row, kind="logged") for row in rows]).drifted, "as records of 40 days they would"


@pytest.mark.parametrize(
    ("scale", "verdict", "good"), [(1.0, "as stated", True), (2.0, "more than stated", False), (0.4, "less", False)]
)
def test_the_scatter_of_repeated_runs_is_set_beside_what_is_stated(scale: float, verdict: str, good: bool) -> None:
    rows = simulated(100, scale)
    (found,) = repeats_of(rows)
    assert found.verdict == verdict
    assert found.interval[0] < found.ratio < found.interval[1]
    assert found.interval[0] < scale < found.interval[1]
    assert report(rows).verdict[1] is good
    assert ("otherwise than stated in stiffness (" in report(rows).sentence) is not good
    assert f"{verdict}" in flat(report(rows))
    assert "Distribution" in flat(report(rows))


@pytest.mark.slow
def test_the_interval_of_the_scatter_holds_it_as_often_as_it_says() -> None:
    dice, held = np.random.default_rng(1), 0
    for _ in range(2000):
        rows = [made(Simulated((), seed=seed), float(value)) for seed, value in enumerate(dice.standard_normal(8))]
        lower, upper = next(repeats_of(rows)).interval
        held += lower <= 1 <= upper
    assert 0.935 < held / 2000 < 0.965


def test_a_run_that_stands_out_is_named_by_its_seed() -> None:
    rows = simulated(40)
    rows[17] = made(Simulated((), seed=17), 50.0)
    said = flat(report(rows))
    assert "Runs that stand out from the others" in said
    assert "stiffness seed 17 150" in said
    assert "Runs that stand out" not in flat(report(simulated(40)))


def test_the_best_of_many_starts_is_that_of_the_least_error() -> None:
    rows = [made(Started((), seed), 0.01 * (seed % 3), error=8.0 + 1e-6 * seed) for seed in range(5)]
    assert report(rows).sentence == "5 of 5 searches ended at the best fit."
    rows += [made(Started((), 5), -30.0, error=9.5), made(Started((), 6), 40.0, error=7.5)]
    found = report(rows)
    assert found.sentence == "1 of 7 searches ended at the best fit, the others elsewhere."
    ((best, most, worst),) = ends_of(rows)
    assert (best.best.seed, len(most.searches), worst.best.seed) == (6, 5, 5)
    said = flat(found)
    assert "stiffness 140.00 1.00 N/m" in said
    assert "5 8.0000 seed 0 40.0 in stiffness" in said
    for word in ("Distribution", "Scatter", "Drift", "stand out"):
        assert word not in said


def test_an_end_whose_parameter_is_refused_is_another_end() -> None:
    rows = [made(Started((), seed), 0.0) for seed in range(2)]
    rows[1] = replace(rows[1], found=rows[1].found | {"stiffness": Found(None, None, "N/m")})
    assert [len(end.searches) for end in ends_of(rows)[0]] == [1, 1]


def test_the_effect_of_each_swept_setting_is_that_on_the_same_run() -> None:
    rows = [
        replace(row, error_percent=10.0 if "x=100" in row.changes else 8.0)
        for x, y in ((20, "a"), (100, "a"), (20, "b"), (100, "b"))
        for row in simulated(20, 3.0, f"x={x}", f'y="{y}"', shift=5.0 * (x == 100))
    ]
    rows[3] = replace(rows[3], outcome=Outcome.REFUSED, found={})
    said = flat(report(rows))
    assert "x=20 39 of 40 8.0000 x=100 40 of 40 10.000" in said
    assert "x=100 for 20 stiffness +5.00 +5.0 39" in said, "of seeds that scatter by 3 the pairs differ by 5"
    assert 'y="b" for "a" stiffness +0 +0 39' in said
    fixed = [replace(row, changes=("method.start=1",)) for row in simulated(5)]
    assert "Swept" not in flat(report(fixed)), "what all have is not swept"


def test_a_fleet_that_is_swept_has_its_chart_and_its_effects() -> None:
    rows = [
        replace(made(None, shift + (k > 9) * -10 + 0.1 * (-1) ** k, f"x={x}"), day=f"2026-11-{k + 1:02}", record=str(k))
        for x, shift in ((1, 0.0), (2, 2.0)) for k in range(20)
    ]  # fmt: skip
    found = report(rows)
    assert len(found.drifted) == 2
    assert "x=2 for 1 stiffness +2.1" in flat(found)


def test_few_runs_say_what_is_needed() -> None:
    assert report(simulated(2)).verdict == (
        "2 simulated runs with an answer; three are needed to say how they scatter.",
        None,
    )
    refused = replace(made(Started((), 1), 0.0), outcome=Outcome.REFUSED, found={})
    assert report([refused]).verdict == ("No search has come to an answer.", None)
