"""The likeliest cause of a gross misfit, before the identification, and without tests of small deviations."""

from dataclasses import replace

import pytest

import jointid as ji
from jointid.diagnostics import find_causes as searching
from jointid.diagnostics.find_causes import screen_causes
from tests.diagnostics.test_undeclared import JOINT, LAW, logged

LOOP = ji.ClosedLoop(JOINT, LAW)


def test_gross_cause_is_told_first_and_the_tests_of_small_ones_left_out():
    said = []
    wrong = replace(LOOP, controller=replace(LAW, velocity_gain=1.5))
    found = ji.identify(logged(), wrong, ji.DIDIM(frequency=50.0), progress=said.append)
    assert said[0].startswith("the likeliest cause so far: the torque is about 2")
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


@pytest.mark.parametrize("clear", [True, False])
def test_cause_of_a_refused_spring_is_told_however_little_the_misfit_is(monkeypatch, clear):
    monkeypatch.setattr(searching, "_SUSPICIOUS", 1.0)
    monkeypatch.setattr(searching.Causes, "is_clear", clear)
    monkeypatch.setattr(searching, "_is_doubtful", lambda *_: False)
    wrong = replace(LOOP, controller=replace(LAW, velocity_gain=1.5))
    found = ji.identify(logged(), wrong, ji.DIDIM(frequency=6.0))
    assert found["stiffness"].value is None
    assert "the torque is about 2" in str(found.answer)
