"""The solver gets there: from nothing, from wrong starts, on plants of any size, and in few simulations."""

from typing import Literal

import pytest

from studies.random_plants import judge

SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    ("seed", "family", "spread"),
    [
        (2, "prismatic", 0.0), (2, "rotary", 10.0),
        pytest.param(2, "rotary", 0.0, marks=SLOW), pytest.param(2, "prismatic", 10.0, marks=SLOW),
        pytest.param(67, "rotary", 0.0, marks=SLOW),  # every spring on its rigid joint is unstable
        pytest.param(69, "rotary", 0.0, marks=SLOW),  # its mode lies beside the cut-off of its rigid start
    ],
)  # fmt: skip
def test_a_plant_is_identified(seed: int, family: Literal["prismatic", "rotary"], spread: float) -> None:
    """From nothing, or from starts within a factor of ten."""
    found = judge(seed, family, spread)
    assert not found.error
    assert found.at_noise
    assert found.simulations <= 250 or seed != 2 or spread
