"""Choices of a joint file that the command line replaces."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import pytest

from jointid.common.errors import JointFileError
from jointid.config import (
    load,
    loads,
    save,
)
from jointid.estimation.methods.didim import DIDIM
from jointid.estimation.methods.flexible import FlexibleDIDIM
from jointid.estimation.methods.idim import IDIM
from jointid.models.friction import AsymmetricFriction
from jointid.models.joints import RigidJoint
from jointid.records.signals.filtering import Filtering
from tests.joint_files import (
    BOTH_ENCODERS,
    CASCADE,
    CHANNELS,
    FLEXIBLE,
    JOINT,
    SMALLEST,
)


def test_overrides_are_checked_in_the_same_way() -> None:
    file = loads(JOINT + CHANNELS.replace("motor_", "load_") + CASCADE + "[parameters]\nviscous = 3.0")
    with pytest.raises(JointFileError) as caught:
        file.override(method="idim", friction="asymmetric")
    motor_position, viscous = caught.value.faults
    assert motor_position.startswith("record.channels.motor_position is missing, but IDIM needs it: add it")
    assert viscous.startswith("parameters.viscous is not known for a rigid joint with asymmetric friction")
    with pytest.raises(JointFileError, match=r'method.name is "didm"; expected .*: did you mean "didim"\?'):
        file.override(method="didm")
    with pytest.raises(JointFileError, match=r'preset is "x"; expected "default", "published" or "as-printed"'):
        file.override(filtering="x")
    with pytest.raises(JointFileError, match=r"^method.minimiser is for DIDIM of a flexible joint, but .* is rigid"):
        file.override(minimiser="nelder-mead")
    with pytest.raises(JointFileError, match=r"^method.frequency is for DIDIM, but the method is IDIM"):
        loads(JOINT + 'model = "flexible"\n' + BOTH_ENCODERS).override(frequency=30.0)


def test_an_override_replaces_one_choice() -> None:
    file = loads(SMALLEST + '[method]\nform = "paper"\n[filtering]\ncutoff = 3.0')
    assert file.override() == file
    assert file.override(method="didim") == file
    assert file.override(method="idim") == dataclasses.replace(file, method=IDIM())
    assert file.override(method="idim").override(method="didim").method == DIDIM()
    assert file.override(filtering="published") == dataclasses.replace(file, filtering=Filtering.published())
    assert file.override(filtering="default") == dataclasses.replace(file, filtering=Filtering())
    assert file.override(friction="asymmetric").joint == RigidJoint(friction=AsymmetricFriction())
    assert file.override(friction="symmetric") == file


def test_an_override_of_a_flexible_joint() -> None:
    file = loads(FLEXIBLE.replace(CHANNELS, BOTH_ENCODERS) + '[method]\npreset = "paper"')
    paper = FlexibleDIDIM.paper()
    assert file.override() == file
    assert file.override(frequency=42.0).method == FlexibleDIDIM.paper(42.0)
    assert file.override(minimiser="nelder-mead") == file
    changed = file.override(minimiser="least-squares", frequency=20.0, filtering="as-printed")
    assert changed.method == dataclasses.replace(paper, minimiser="least-squares", frequency=20.0)
    assert changed.filtering == Filtering.as_printed()
    assert file.override(method="idim").method == IDIM()
    back = file.override(method="idim").override(method="didim", frequency=9.0)
    assert back.method == FlexibleDIDIM(frequency=9.0)
    with pytest.raises(JointFileError, match=r'minimiser is "simplex"; expected "least-squares" or "nelder-mead"'):
        file.override(minimiser="simplex")
    with pytest.raises(JointFileError, match=r"frequency is 0.0; expected a positive number"):
        file.override(frequency=0.0)


def test_an_override_keeps_the_folder(tmp_path: Path) -> None:
    save(loads(SMALLEST), tmp_path / "joint.toml")
    assert load(tmp_path / "joint.toml").override(method="idim").path == tmp_path / "joint.toml"
