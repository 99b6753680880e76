"""The likeliest cause of a gross misfit, before the identification, and without tests of small deviations."""

from dataclasses import replace

import pytest

import jointid as ji
from jointid.diagnostics import find_causes as searching
from jointid.diagnostics import identify as identifying
from jointid.diagnostics.find_causes import list_hypotheses, screen_causes
from jointid.diagnostics.hypothesis_fits import fit_below_resonance, fit_flexible
from jointid.records.signals.filtering import Filtering
from tests.diagnostics.test_undeclared import JOINT, LAW, logged

LOOP = ji.ClosedLoop(JOINT, LAW)


@pytest.mark.slow
def test_gross_cause_is_told_first_and_the_tests_of_small_ones_left_out():
    said = []
    wrong = replace(LOOP, controller=replace(LAW, velocity_gain=1.5))
    found = ji.identify(logged(), wrong, ji.DIDIM(frequency=50.0), progress=said.append)
    likeliest = next(i for i, one in enumerate(said) if one.startswith("the likeliest cause so far: the law's gain"))
    assert "about 2" in said[likeliest]
    assert not any(one.startswith("searching for the cause") for one in said[:likeliest])
    assert not any(one.startswith("checking loop and log") for one in said)
    assert [one for one in said if len(one) > 150] == [one for one in dict.fromkeys(said) if len(one) > 150]
    assert found.checks.verdicts[-1].reasons[0].code == "cause_found"


def test_wrong_sign_is_told():
    record, said = logged(), []
    torque = replace(record.torque, values=-record.torque.values)
    fits = screen_causes(replace(record, torque=torque), LOOP, progress=said.append)
    assert fits[0].hypothesis.fault.name == "torque_sign"
    assert len(said) == 1


@pytest.mark.parametrize("hidden", [0.0, 0.5e-3])
def test_record_that_the_declared_drive_roughly_fits_is_not_screened(hidden):
    assert screen_causes(logged(hidden), LOOP) == []


def test_drive_whose_spring_is_found_at_once_is_not_screened(monkeypatch):
    screened = []
    monkeypatch.setattr(identifying, "screen_causes", lambda *_: screened.append(1))
    ji.identify(logged(), LOOP, ji.DIDIM(frequency=50.0))
    assert not screened


def test_cause_that_the_begin_shows_and_the_whole_record_excludes_is_left_out():
    tried = list_hypotheses(logged(), LOOP, Filtering().resolve(1e-3, "flexible"))
    low = fit_below_resonance(tried[:2], JOINT)
    assert len(low) == 2
    assert [fit.hypothesis.fault for fit in fit_flexible(tried[:1], LOOP, low)] == [None]


@pytest.mark.slow
@pytest.mark.parametrize("clear", [True, False])
def test_cause_of_a_refused_spring_is_told_however_little_the_misfit_is(monkeypatch, clear):
    monkeypatch.setattr(searching, "_SUSPICIOUS", 1.0)
    monkeypatch.setattr(searching.Causes, "is_clear", clear)
    monkeypatch.setattr(searching, "_is_doubtful", lambda *_: False)
    wrong = replace(LOOP, controller=replace(LAW, velocity_gain=1.5))
    found = ji.identify(logged(), wrong, ji.DIDIM(frequency=6.0))
    assert found["stiffness"].value is None
    assert "the law's gain (velocity_gain or gain) is declared about 2" in str(found.answer)
