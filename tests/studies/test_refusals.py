"""A spring made stiffer until no record shows it: values where they can be known, bounds elsewhere, and both true."""

from __future__ import annotations

from typing import Literal

import pytest

from jointid.common.errors import MethodError
from jointid.paper.twin import twin
from studies.refusals import refusals
from tests.estimates import identify


def test_a_plain_spring_is_given_and_its_prediction_comes_true() -> None:
    (run,) = refusals((1.0,), seeds=(1,), noises=("white",)).runs
    assert run.value is not None
    assert run.std == pytest.approx(run.predicted * run.stiffness, rel=0.2)
    assert run.holds


def test_a_spring_is_not_made_stiffer_by_nothing() -> None:
    with pytest.raises(MethodError, match="positive factor; received 0"):
        twin(stiffer=0.0)


@pytest.mark.slow
@pytest.mark.parametrize(("factor", "noise", "given"), [(50.0, "white", True), (100.0, "disturbance", False)])
def test_a_whole_identification_says_the_same(
    factor: float, noise: Literal["disturbance", "white"], given: bool
) -> None:
    """In the table the fit begins at the truth; here it begins from nothing."""
    axis = twin("L19", noise=noise, seed=1, stiffer=factor)
    estimate = identify(axis.record.without("motor_position", "load_position"), axis.loop)
    (run,) = refusals((factor,), seeds=(1,), noises=(noise,)).runs
    assert (run.value is not None) is given
    stiffness = estimate["stiffness"]
    assert (stiffness.value is not None) is given
    if given:
        assert stiffness.value == pytest.approx(run.value, rel=1e-3)
    else:  # the search may have ended on another band, whose bound is another one
        bounds = {bound.share: bound.stiffness for bound in estimate.checks.bounds}
        assert 1e7 <= (bounds[0.33] or 0.0) < run.stiffness
