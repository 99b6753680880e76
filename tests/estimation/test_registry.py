"""The registry of the methods: every line of it leads to a method that says of itself what the line says."""

import pytest

import jointid as ji
from jointid.estimation.methods.registry import METHODS, MODELS, default_method, methods
from jointid.simulation.drive_side import DriveSide


@pytest.mark.parametrize(("name", "method"), list(zip(METHODS, methods(), strict=True)))
def test_a_method_says_its_name_and_its_needs(name: str, method: type[ji.DIDIM]) -> None:
    assert (method.name, bool(method.title)) == (name, True)
    for model in MODELS:
        assert "torque" in method.channels(model)


def test_what_is_identified_chooses_its_method() -> None:
    joint = ji.FlexibleJoint("prismatic")
    loop = ji.ClosedLoop(joint, ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0))
    chosen = [default_method(model) for model in (loop, joint, DriveSide(joint))]
    assert chosen == [ji.DIDIM, ji.IDIM, ji.DriveSideFit]
