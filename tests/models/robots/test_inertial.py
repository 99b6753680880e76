"""The inertial parameters in their three forms, and which of them a body can have."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from jointid.common.errors import MethodError
from jointid.models.robots.inertial import (
    MassProperties,
    change_frame,
    inertial_of,
    is_physical,
    mass_properties,
    pseudo_inertia,
)
from tests.models.robots.trees import random_body


def test_the_three_forms_say_the_same() -> None:
    body = random_body(np.random.default_rng(1))
    assert mass_properties(body).inertial == pytest.approx(body, rel=1e-13)
    assert inertial_of(pseudo_inertia(body)) == pytest.approx(body, rel=1e-13)


def test_a_ball_away_from_the_origin() -> None:
    ball = MassProperties(2.0, np.array([0.0, 3.0, 0.0]), 0.5 * np.eye(3)).inertial
    assert ball == pytest.approx([2, 0, 6, 0, 18.5, 0, 0, 0.5, 0, 18.5])


def test_a_body_seen_from_another_frame() -> None:
    random = np.random.default_rng(2)
    masses, points = random.uniform(0.1, 1.0, 5), random.normal(size=(5, 3))
    turn, origin = Rotation.random(random_state=3).as_matrix(), random.normal(size=3)

    def of(points: np.ndarray) -> np.ndarray:
        pseudo = sum(m * np.outer([*r, 1.0], [*r, 1.0]) for m, r in zip(masses, points, strict=True))
        return inertial_of(np.asarray(pseudo))

    assert change_frame(of(points), turn, origin) == pytest.approx(of(points @ turn.T + origin), rel=1e-12)


@pytest.mark.parametrize(
    ("inertia", "possible"),
    [((1.0, 1.0, 1.0), True), ((1.0, 1.0, 2.0), True), ((1.0, 1.0, 2.01), False), ((0.0, 1.0, 1.0), True),
     ((-0.01, 1.0, 1.0), False)],
)  # fmt: skip
def test_moments_of_a_body_keep_the_triangle_inequality(inertia: tuple[float, ...], possible: bool) -> None:
    turn = Rotation.random(random_state=5).as_matrix()
    body = MassProperties(3.0, np.array([0.1, -0.2, 0.3]), turn @ np.diag(inertia) @ turn.T)
    assert is_physical(body.inertial) is possible


def test_masses_that_are_none() -> None:
    assert is_physical(np.zeros(10))
    assert not is_physical(np.array([0.0, 1.0, *np.zeros(8)]))
    assert not is_physical(-random_body(np.random.default_rng(1)))
    with pytest.raises(MethodError, match="no centre of mass"):
        mass_properties(np.zeros(10))
