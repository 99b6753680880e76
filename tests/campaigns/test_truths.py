"""Simulated runs beside their truth: bias, scatter, and how often the stated interval holds it."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jointid.campaigns.cases import Case, Found, Outcome, Row, Simulated
from jointid.campaigns.folder import Results
from jointid.campaigns.report import CampaignReport, table_of
from jointid.campaigns.run import run_case
from jointid.campaigns.run_groups import truth_csv
from jointid.common.errors import RecordError
from tests.campaigns.conftest import TRUTH
from tests.campaigns.test_cases import campaign as cases_of


def runs(count: int, seed: int = 4, *, scale: float = 1.0, shift: float = 0.0, **more: float) -> list[Row]:
    """Return rows whose stiffness is 100 and its stated deviation 1; others are given as names with shifts."""
    dice, shifts = np.random.default_rng(seed), {"stiffness": shift, **more}
    made = []
    for number in range(count):
        found = {
            name: Found(float(100 + off + scale * dice.standard_normal()), 1.0, "N/m") for name, off in shifts.items()
        }
        case = Case("axis", "", "run.npy", "", varied=Simulated((), seed=number))
        truth = dict.fromkeys(shifts, 100.0)
        made.append(Row.of(case, Outcome.IDENTIFIED, "", found=found, error_percent=8.0, truth=truth))
    return made


def report(rows: list[Row]) -> CampaignReport:
    return CampaignReport(Results("runs", len(rows), tuple(rows), tuple(map(float, range(len(rows))))))


def test_right_intervals_hold_the_truth_as_often_as_they_say() -> None:
    found = report(runs(200))
    (one,) = found.against_truth
    assert one.truth == 100.0
    assert one.bias == pytest.approx(np.mean([row.found["stiffness"].value for row in runs(200)]) - 100.0, abs=1e-12)
    assert one.bias_std == pytest.approx(one.scatter / np.sqrt(200), rel=1e-12)
    assert one.low < 0.9545 < one.high
    # Clopper and Pearson's range of 10 of 10 is 0.025^(1/10) to 1.
    few = report(runs(10, scale=0.1)).against_truth[0]
    assert (few.held, few.low, few.high) == (10, pytest.approx(0.025**0.1), 1.0)
    assert one.verdict == "as stated"
    assert found.sentence.endswith("Two stated deviations hold the truth as often as they say, and no bias is sure.")
    assert found.verdict[1] is True


@pytest.mark.slow
def test_too_narrow_intervals_and_a_bias_are_named() -> None:
    found = report(runs(200, scale=1.6))
    assert found.against_truth[0].verdict == "held too seldom"
    assert "less often than they say in stiffness (8" in found.sentence
    found = report(runs(200, shift=0.5))
    assert found.against_truth[0].verdict == "biased"
    assert "Biased: stiffness (+0.5" in found.sentence
    assert found.verdict[1] is False, "the scatter alone is as stated"
    assert report(runs(20000, shift=0.05)).against_truth[0].verdict == "as stated", "sure, and too small to matter"
    only = report(runs(200, shift=0.0, damping=3.0))
    assert [one.verdict for one in only.against_truth] == ["as stated", "biased and held too seldom"]


def test_it_stands_in_table_page_and_csv_alike() -> None:
    found = report(runs(200, shift=0.5))
    (one,) = found.against_truth
    for said in (found.to_document().text(), found.to_document().markdown()):
        assert "Errors against the truth" in said
        assert f"{one.bias:+.2f}" in said
        assert f"{100 * one.low:.0f} to {100 * one.high:.0f}" in said
    (row,) = csv.DictReader(truth_csv(found.against_truth).splitlines())
    assert float(row["bias"]) == one.bias
    assert (int(row["held"]), int(row["runs"]), row["verdict"]) == (one.held, 200, "biased")
    without = report([replace(row, truth={}) for row in runs(20)])
    assert "truth" not in without.to_document().text()
    with pytest.raises(RecordError, match=r"^--csv has the errors against the truth, and these runs have none"):
        truth_csv(without.against_truth)


def test_a_simulated_run_knows_its_truth(place: Path) -> None:
    values = "".join(f"{name} = {value}\n" for name, value in TRUTH.items())
    text = '[monte_carlo]\njoint = "joint.toml"\nrecord = "logs/a/2026-11-01.npy"\nruns = 1\nnoise_log = 0.1\n'
    row = run_case(cases_of(place, f"{text}[monte_carlo.values]\n{values}")[0])
    assert dict(row.truth) == TRUTH
    assert Row.read(row.text()) == row
    assert table_of([row])["inertia truth [kg]"] == [TRUTH["inertia"]]


@pytest.mark.slow
def test_a_campaign_without_a_fault_is_called_faulty_once_in_a_hundred_at_most() -> None:
    of_seven = dict.fromkeys("abcdef", 0.0)
    told = [report(runs(60, seed, **of_seven)).against_truth for seed in range(300)]
    assert all(len(one) == 7 for one in told)
    faulty = sum(any(one.verdict != "as stated" for one in campaign) for campaign in told)
    assert faulty <= 0.02 * 300 + 3 * np.sqrt(0.02 * 300)
