"""The flexible joint of the paper, on its digital twin."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.assessment.validation import validate
from jointid.common.errors import RecordError
from jointid.data.signals import Filtering
from jointid.estimation.estimate import Estimate
from jointid.estimation.identify import identify
from jointid.estimation.idim import IDIM
from jointid.paper.twin import twin


def deviations(estimate: Estimate, truth: dict[str, float]) -> dict[str, float]:
    """Return the errors in standard deviations."""
    return {
        name: (value - truth[name]) / float(estimate[name].std or np.nan) for name, value in estimate.values.items()
    }


@pytest.mark.parametrize("loop", ["L19", "L30"])
def test_idim_recovers_the_noise_free_twin(loop: str) -> None:
    """Both rows of (2), torque held, and for L30 a period of delay; much better than the 1 % and 3 % asked for."""
    axis = twin(loop, noise="none")  # type: ignore[arg-type]
    estimate = identify(axis.record, axis.loop, IDIM())
    assert estimate.channels == ("torque", "motor_position", "load_position", "injected")
    for name, value in estimate.values.items():
        assert abs(value / axis.truth[name] - 1) <= (0.01 if name == "damping" else 1e-3), name


def test_idim_needs_the_timing_respected() -> None:
    axis = twin(noise="none")
    sampled = identify(axis.record, axis.loop, IDIM(), filtering=Filtering(timing="as_sampled"))
    worst = {name: abs(value / axis.truth[name] - 1) for name, value in sampled.values.items()}
    assert max(worst.values()) > 0.05


@pytest.mark.parametrize("loop", ["L19", "L30"])
@pytest.mark.parametrize("seed", range(1, 6))
def test_idim_under_the_paper_s_noise_on_the_log(loop: str, seed: int) -> None:
    axis = twin(loop, noise="white", seed=seed)  # type: ignore[arg-type]
    estimate = identify(axis.record, axis.loop, IDIM())
    assert estimate.filtered_error == pytest.approx(0.08, abs=0.005)
    assert all(abs(d) <= 3.0 for d in deviations(estimate, axis.truth).values())


def test_idim_needs_the_load_position() -> None:
    axis = twin(noise="none")
    with pytest.raises(RecordError, match="IDIM of a flexible joint needs load_position; this record has torque"):
        identify(axis.record.without("load_position"), axis.loop, IDIM())


def test_an_idim_estimate_is_validated_on_both_rows() -> None:
    axis, other = twin(noise="white", seed=1), twin(noise="white", seed=2)
    estimate = identify(axis.record, axis.loop, IDIM())
    assert validate(estimate, axis.record).filtered_error == pytest.approx(estimate.filtered_error, rel=1e-9)
    assert validate(estimate, other.record).filtered_error == pytest.approx(0.08, abs=0.005)
