"""Flexible joints whose spring or friction is smooth, identified from torque and reference."""

import pytest

from tests.estimates import identify
from tests.estimation.test_stribeck import noisy
from tests.plants import LAWS, prismatic, with_law


@pytest.mark.slow
@pytest.mark.parametrize("law", LAWS)
def test_a_flexible_joint_tells_its_law(law: str) -> None:
    case = prismatic(1)
    loop, values = with_law(case, law)
    found = identify(noisy(case, loop, values), loop)
    assert abs(found["stiffness"].value - values["stiffness"]) < 3 * found["stiffness"].stderr
    for p in found.rows:
        if p.of_joint and p.value is not None and p.stderr:
            assert abs(p.value - values[p.name]) < 4.5 * p.stderr, p.name
