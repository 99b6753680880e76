"""The share of a residual that follows other axes, and the share that would by chance."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.uncertainty.residual_tests import coupling


def test_chance_is_that_of_motions_that_have_nothing_to_do_with_each_other() -> None:
    """In 95 of 100 cases no more is explained than by chance; slow motions explain much of each other."""
    rng = np.random.default_rng(0)
    slow = np.convolve(rng.normal(size=100_000), np.ones(20) / 20, "valid")
    rows = slow[: slow.size // 300 * 300].reshape(-1, 300)
    found = [coupling(rows[3 * k], rows[3 * k + 1 : 3 * k + 3].T) for k in range(len(rows) // 3)]
    assert 0.85 <= np.mean([not one.seen for one in found]) <= 0.99
    assert np.mean([one.by_chance for one in found]) > 0.1
    exact = coupling(rows[0], rows[:2].T)
    assert exact.explained == pytest.approx(1.0)
    assert coupling(np.zeros(50), rows[:2, :50].T).seen is False
