"""Swept settings side by side."""

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


def test_each_combination_of_settings_has_its_share_error_and_distribution() -> None:
    noise = 3.0 * np.random.default_rng(4).standard_normal(20)
    rows = [
        replace(made(value + 5.0 * (x == 100), f"x={x}", day=day), error_percent=10.0 if x == 100 else 8.0)
        for x in (20, 100)
        for day, value in enumerate(noise)
    ]
    rows[3] = replace(rows[3], outcome=Outcome.REFUSED, found={})
    text = " ".join(CampaignReport("runs", tuple(rows)).to_document(details=True).text().split())
    assert "x=20 19 of 20 identified, median error 8.0000 %" in text
    assert "x=100 20 of 20 identified, median error 10.000 %" in text
