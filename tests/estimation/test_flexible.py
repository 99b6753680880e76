"""The flexible joint of the paper, on its digital twin."""

from __future__ import annotations

import numpy as np
import pytest

from jointid.assessment.validation import validate
from jointid.common.errors import MethodError, RecordError
from jointid.data.record import Record
from jointid.data.signals import Filtering
from jointid.estimation import flexible
from jointid.estimation.estimate import Estimate
from jointid.estimation.flexible import FlexibleDIDIM
from jointid.estimation.identify import identify
from jointid.estimation.idim import IDIM
from jointid.estimation.problem import INITIAL_STATE
from jointid.model.joints import FlexibleJoint, RigidJoint
from jointid.paper.twin import Twin, twin
from jointid.simulation.experiment import ClosedLoop
from tests.estimation.conftest import CONTROLLER


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


def torque_only(axis: Twin) -> Record:
    return axis.record.without("motor_position", "load_position")


@pytest.mark.parametrize("loop", ["L19", "L30"])
@pytest.mark.parametrize("noise", ["disturbance", "white"])
def test_didim_finds_stiffness_inertias_and_the_sums_of_friction_from_torque_alone(loop: str, noise: str) -> None:
    axis = twin(loop, noise=noise)  # type: ignore[arg-type]
    estimate = identify(torque_only(axis), axis.loop)
    assert estimate.method == "didim"
    assert estimate.channels == ("torque", "reference", "injected")
    assert estimate.filtered_error == pytest.approx(0.08, abs=0.002)
    assert all(abs(d) <= 3.0 for d in deviations(estimate, axis.truth).values())
    for name in ("motor_inertia", "load_inertia", "stiffness"):
        assert abs(estimate.values[name] / axis.truth[name] - 1) <= 0.01, name
    for friction in ("viscous", "coulomb"):
        total = sum(axis.truth[f"{side}_{friction}"] for side in ("motor", "load"))
        found = sum(estimate.values[f"{side}_{friction}"] for side in ("motor", "load"))
        assert abs(found / total - 1) <= 0.02
    assert any("load_viscous and motor_viscous are hard to tell apart" in warning for warning in estimate.warnings)
    assert estimate.converged


def test_didim_recovers_the_noise_free_twin() -> None:
    axis = twin(noise="none")
    estimate = identify(torque_only(axis), axis.loop)
    assert all(abs(value / axis.truth[name] - 1) <= 1e-5 for name, value in estimate.values.items())


def test_any_known_frequency_leads_to_the_same_answer() -> None:
    axis = twin(noise="white")
    record = torque_only(axis)
    stiffness = [
        identify(record, axis.loop, FlexibleDIDIM(frequency=f)).values["stiffness"] for f in (15.0, 30.0, 45.0)
    ]
    assert max(stiffness) / min(stiffness) - 1 <= 1e-4


@pytest.mark.parametrize("noise", ["disturbance", "white"])
def test_nelder_mead_reaches_the_minimum_after_one_restart(noise: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """By ``fminsearch`` rules, from (13) at 30 Hz; the best known is least squares from four starts."""
    from jointid.simulation import kernels

    axis = twin(noise=noise)  # type: ignore[arg-type]
    record = torque_only(axis)
    calls = []
    original = kernels.run
    monkeypatch.setattr(kernels, "run", lambda *arguments: (calls.append(1), original(*arguments))[1])
    simplex = identify(record, axis.loop, FlexibleDIDIM.paper())
    assert simplex.simulations == len(calls)  # the reported simulations are those counted
    assert simplex.stop.count("iterations") == 2  # one descent and one restart
    initial = {p.name: p.value for p in simplex.parameters if not p.of_joint}
    monkeypatch.setattr(
        flexible, "_initial_state", lambda *_: tuple(p.fixed(initial[p.name] or 0.0) for p in INITIAL_STATE)
    )
    best = identify(record, axis.loop)
    assert (simplex.filtered_error / best.filtered_error) ** 2 - 1 <= 1e-4
    assert simplex.simulations > 2 * best.simulations
    assert "inverse model" in simplex.intervals


@pytest.mark.parametrize("method", [IDIM(), FlexibleDIDIM(), FlexibleDIDIM.paper()], ids=["idim", "ls", "simplex"])
def test_ten_kilograms_on_the_load_are_found_there(method: IDIM | FlexibleDIDIM) -> None:
    before, after = twin(seed=1), twin(seed=2, added_mass=True)
    first, second = (identify(axis.record, axis.loop, method) for axis in (before, after))
    assert second.values["load_inertia"] - first.values["load_inertia"] == pytest.approx(10.2, abs=0.6)
    if isinstance(method, FlexibleDIDIM) and method.statistics == "inverse-model":
        return  # its deviations are too small to judge a change by
    for name, value in first.values.items():
        if name == "load_inertia":
            continue
        true_change = after.truth[name] - before.truth[name]
        spread = float(np.hypot(first[name].std or 0.0, second[name].std or 0.0))
        assert abs(second.values[name] - value - true_change) <= 3 * spread, name


def test_the_filter_as_printed_warns() -> None:
    axis = twin(noise="white")
    estimate = identify(torque_only(axis), axis.loop, FlexibleDIDIM(frequency=30.0), filtering=Filtering.as_printed())
    assert any("one sample in 12 has its Nyquist frequency at 41.7 Hz" in warning for warning in estimate.warnings)
    assert estimate.filtering.decimation == 12
    assert abs(estimate.values["stiffness"] / axis.truth["stiffness"] - 1) <= 0.05


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(MethodError, match="minimiser is one of least-squares, nelder-mead"):
        FlexibleDIDIM(minimiser="simplex")  # type: ignore[arg-type]
    with pytest.raises(MethodError, match="positive"):
        FlexibleDIDIM(frequency=-3.0)
    axis = twin(noise="none")
    with pytest.raises(MethodError, match="FlexibleDIDIM is not for a rigid joint; use DIDIM"):
        identify(axis.record, ClosedLoop(RigidJoint(), axis.loop.controller), FlexibleDIDIM())


def test_a_stiffness_the_record_does_not_show_is_not_called_identifiable(emps: Record) -> None:
    """The public EMPS record has no flexible mode: the interval of its stiffness holds 0, and the answer says so."""
    loop = ClosedLoop(FlexibleJoint(), CONTROLLER)
    estimate = identify(emps.without("motor_position"), loop)
    assert not estimate["stiffness"].identifiable
    assert any("stiffness is not identifiable from this record" in warning for warning in estimate.warnings)
    axis = twin(noise="white")
    assert identify(torque_only(axis), axis.loop, FlexibleDIDIM(frequency=30.0))["stiffness"].identifiable
