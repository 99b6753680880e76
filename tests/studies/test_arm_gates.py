"""The arm that MuJoCo moves: within the gates from a shorter log; the table says the worst."""

from __future__ import annotations

import json

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo, of the extra robots, makes the independent data")

from studies.arm_gates import EXPECTED, judge, summarise


@pytest.mark.slow
def test_an_arm_is_within_the_gates() -> None:
    """A log of half the length, with errors twice as large as those that are expected at most."""
    found = judge(3, ("torque", "position"), length=10.0)
    json.dumps(found)  # as a campaign keeps it
    for column in found.values():
        assert np.all(np.array(column["errors"]) < 2.0 * np.array(EXPECTED))
        assert np.mean(np.abs(column["z"]) < 2.0) > 0.85
        assert column["relied"]
    assert "| to be relied on | | | 1 | 1 |" in summarise([found])
