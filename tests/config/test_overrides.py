"""Choices of the command line, and keys that it sets, in place of what the joint file says."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from jointid.common.errors import JointFileError
from jointid.config import loads
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import RigidJoint
from jointid.records.signals.filtering import Filtering
from tests.joint_files import BOTH_ENCODERS, CASCADE, CHANNELS, FLEXIBLE, JOINT, SMALLEST


@pytest.mark.parametrize(
    "choices",
    [
        {"method": "didm"}, {"filtering": "x"}, {"friction": "dahl"}, {"method": "idim", "friction": "asymmetric"},
        {"changes": ["method.minimiser=nelder-mead"]}, {"changes": ["method.frequency=0.0"]},
    ],
)  # fmt: skip
def test_choices_are_checked_in_the_same_way(choices: dict[str, Any]) -> None:
    text = JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + "[parameters]\nviscous = 3.0"
    with pytest.raises(JointFileError):
        loads(text, **choices)


def test_a_choice_replaces_what_the_file_says() -> None:
    text = SMALLEST + '[method]\nform = "paper"\n[filtering]\ncutoff = 3.0'
    file = loads(text)
    assert loads(text, changes=[]) == file
    assert file.method == DIDIM(form="paper")
    assert loads(text, method="didim") == file  # its settings are kept, though the file does not name it
    assert loads(text, method="idim") == dataclasses.replace(file, method=IDIM())
    assert loads(text.replace("form =", 'name = "idim"\n# form ='), method="didim").method == DIDIM()
    assert loads(text, filtering="published") == dataclasses.replace(file, filtering=Filtering.published())
    assert loads(text, filtering="default") == dataclasses.replace(file, filtering=Filtering())
    assert loads(text, friction="asymmetric").joint == RigidJoint("prismatic", friction=AsymmetricFriction())
    assert loads(text, friction="symmetric") == file


def test_keys_are_set_after_the_choices() -> None:
    text = FLEXIBLE.replace(CHANNELS, BOTH_ENCODERS) + '[method]\npreset = "paper"'
    assert loads(text, changes=[]) == loads(text)
    assert loads(text, changes=["method.frequency=42.0"]).method == DIDIM.paper("flexible", 42.0)
    changed = loads(text, changes=["method.frequency=20.0"], filtering="as-printed")
    assert changed.method == DIDIM.paper("flexible", 20.0)
    assert changed.filtering == Filtering.as_in_paper()
    whole = ['method={name="didim", minimiser="least-squares", frequency=20.0}']  # in place of the preset, too
    assert loads(text, changes=whole).method == DIDIM(minimiser="least-squares", frequency=20.0)
    assert loads(text, method="idim").method == IDIM()
    assert loads(text, ".", ["method.estimator=ols"], method="idim").method == IDIM(estimator="ols")
    back = loads(text.replace('preset = "paper"', 'name = "idim"'), ".", ["method.frequency=9.0"], method="didim")
    assert back.method == DIDIM(frequency=9.0)


def test_a_choice_holds_against_a_change() -> None:
    text = SMALLEST + '[method]\nform = "paper"'
    assert loads(text, changes=["method.name=idim"], method="didim").method == DIDIM(form="paper")
    assert loads(text, changes=["filtering.preset=published"], filtering="default").filtering == Filtering()
    file = loads(text, changes=["joint.friction=symmetric"], friction="asymmetric")
    assert file.joint.friction == AsymmetricFriction()


def test_a_change_may_bring_what_makes_a_method_the_file_s_own() -> None:
    text = JOINT + CHANNELS + '[method]\nform = "paper"'
    controller = [f"controller={{{', '.join(CASCADE.strip().splitlines()[1:])}}}"]
    assert loads(text, changes=controller, method="didim").method == DIDIM(form="paper")
