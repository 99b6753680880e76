"""A residual that follows the motion, and what is said of a value then."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import jointid as ji
from jointid.common.messages import Message
from jointid.diagnostics import identify as identifying
from jointid.diagnostics.faults.findings import AxisFaults
from jointid.diagnostics.intervals import rebuild_problem
from jointid.diagnostics.search_state import SearchState
from jointid.diagnostics.unmodelled_motion import PredictedResidual, predict_residual
from jointid.estimation.identify import fit as fit_records
from jointid.estimation.result.answer import Trust
from jointid.estimation.result.judge import assemble
from jointid.estimation.result.verdict import Reason, Status, Subject, Verdict
from jointid.models.springs import LinearSpring
from jointid.records.record import Record
from tests.estimates import amended, identify
from tests.plants import Case, gapped_axis, prismatic, with_spring


def predicted(record: Record, case: Case) -> PredictedResidual:
    loop = with_spring(case.loop, LinearSpring())
    estimate = identify(record, loop, ji.DIDIM(frequency=case.mode))
    found = predict_residual(*rebuild_problem(estimate, record))
    assert found is not None
    return found


@pytest.fixture(scope="module")
def of_a_gap() -> PredictedResidual:
    case, record = gapped_axis(16_000)
    return predicted(record, case)


def test_a_residual_that_a_gap_leaves_follows_the_motion(of_a_gap: PredictedResidual) -> None:
    assert of_a_gap.follows
    assert of_a_gap.share > 0.05


@pytest.mark.parametrize("coloured", [False, True])
def test_noise_does_not_follow_it(coloured: bool) -> None:
    case = prismatic(1)
    torque = case.clean.torque
    assert torque is not None
    noise = np.random.default_rng(5).standard_normal(torque.values.size)
    if coloured:
        noise = np.convolve(noise, 0.98 ** np.arange(300))[: noise.size]
    noise *= 0.02 * np.std(torque.values) / np.std(noise)
    record = replace(case.clean, torque=replace(torque, values=torque.values + noise))
    found = predicted(record, case)
    assert not found.follows
    assert found.gain < 0.02


def test_it_is_said_where_loop_and_log_pass(of_a_gap: PredictedResidual, monkeypatch: pytest.MonkeyPatch) -> None:
    case = prismatic(1)
    fit = fit_records(case.noisy(0.01, 1), case.loop, ji.DIDIM(frequency=case.mode))
    repeats = Message(Reason.RESIDUAL_REPEATS, "it repeats")
    before = Verdict(Subject.REPEATABLE, Status.FAILED, (repeats,))
    fit = amended(fit, checks={"verdicts": (before,)})
    nothing_found = AxisFaults((), (), 0.05, {}, {}, None, None, {})
    assert fit.problem is not None
    assert fit.x is not None
    state = SearchState(fit.problem, fit.x)
    monkeypatch.setattr("jointid.diagnostics.diagnosis.search_faults", lambda *_, **__: (nothing_found, state))
    monkeypatch.setattr(identifying, "predict_residual", lambda *_: of_a_gap)
    monkeypatch.setattr(identifying, "explain_misfit", lambda *_: None)
    checked = assemble(fit, identifying.run_checks(fit))
    (said,) = (one for one in checked.checks.verdicts if one.subject is Subject.REPEATABLE)
    assert said.status is Status.FAILED
    assert said.reasons[0].code == Reason.RESIDUAL_FOLLOWS_MOTION
    assert said.reasons[1:] == (repeats,)  # what was said before stays
    assert checked.checks.verdicts[-1].subject is Subject.LOOP
    assert checked.answer.trust.code == Trust.NOT_YET
