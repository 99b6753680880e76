"""The effect of swept settings, run by run, also beside the drift of a fleet."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jointid.campaigns.campaign import Case
from jointid.campaigns.report import CampaignReport
from jointid.campaigns.store import Found, Outcome, Row


def made(value: float, *changes: str, day: int = 0) -> Row:
    """Return a row whose stiffness is 100 of a deviation of 1, plus `value`."""
    found = {"stiffness": Found(100 + value, 1.0, "N/m"), "offset": Found(2.0, None, "N")}
    case = Case("axis", "", f"{day}.npy", "", f"2026-11-{day + 1:02}", changes)
    return Row.of(case, Outcome.IDENTIFIED, "", found=found, error_percent=8.0)


def said(rows: list[Row]) -> tuple[CampaignReport, str]:
    report = CampaignReport("runs", len(rows), tuple(rows))
    return report, " ".join(report.to_document(details=True).text().split())


def test_the_effect_of_each_swept_setting_is_that_on_the_same_run() -> None:
    noise = 3.0 * np.random.default_rng(4).standard_normal(20)
    rows = [
        replace(made(value + 5.0 * (x == 100), f"x={x}", f'y="{y}"', day=day), error_percent=10.0 if x == 100 else 8.0)
        for x, y in ((20, "a"), (100, "a"), (20, "b"), (100, "b"))
        for day, value in enumerate(noise)
    ]
    rows[3] = replace(rows[3], outcome=Outcome.REFUSED, found={})
    _, text = said(rows)
    assert "x=20 39 of 40 8.0000 x=100 40 of 40 10.000" in text
    assert "x=100 for 20 stiffness +5.00 +5.0 39" in text, "of runs that scatter by 3 the pairs differ by 5"
    assert 'y="b" for "a" stiffness +0 +0 39' in text
    fixed = [made(value, "method.start=1", day=day) for day, value in enumerate(noise[:5])]
    assert "Swept" not in said(fixed)[1], "what all have is not swept"


def test_a_fleet_that_is_swept_has_its_chart_and_its_effects() -> None:
    report, text = said(
        [
            made(shift + (day > 9) * -10 + 0.1 * (-1) ** day, f"x={x}", day=day)
            for x, shift in ((1, 0.0), (2, 2.0))
            for day in range(20)
        ]
    )
    assert len(report.drifted) == 2
    assert "x=2 for 1 stiffness +2.1" in text
