"""The remedy of every fault names commands and laws that exist."""

import re

import pytest

from jointid.apps.cli.app import app
from jointid.common.messages import Message
from jointid.diagnostics.changes import AVERAGED, INTERPOLATIONS, MEASURED_VELOCITY, OTHER_LAWS, PERIOD, PRESENT_SAMPLE
from jointid.diagnostics.suspects import FAULTS, AxisFaults, Fault, FaultTest, Finding, OtherLaw
from jointid.models.controllers import PD
from jointid.models.friction import FRICTIONS
from jointid.models.springs import SPRINGS
from jointid.records.record import Tap


def told(fault: Fault) -> Message:
    """Return the statement on a fault of a joint that can have every law."""
    test = FaultTest(fault, (), 1.0, 0.1, 0.01, 1e-9, 0.5)
    other = OtherLaw(fault, "the drive runs another law", "that law", PD(position_gain=1.0, derivative_gain=1.0))
    finding = Finding(test, 1.1, (), {}, other if fault.name in OTHER_LAWS else None)
    return AxisFaults((finding,), (test,), {"position": "rad", "torque": "N m"}).reasons[0]


@pytest.mark.parametrize(
    "fault", [*FAULTS.values(), PRESENT_SAMPLE, MEASURED_VELOCITY, PERIOD, AVERAGED, *INTERPOLATIONS.values()]
)
def test_commands_and_laws_of_a_remedy_are_those_of_the_program(fault: Fault) -> None:
    said = str(reason := told(fault))
    assert reason.values["remedy"] or fault.name == "uneven_friction"  # of which no law is known
    for command in re.findall(r"jointid ([a-z-]+)", said):
        assert list(app.parse_commands([command])[0]) == [command]
        app.parse_args([command, "joint.toml"], exit_on_error=False, print_error=False)
    for value in re.findall(r'(?:spring|friction|tap) = "([\w-]+)"', said):
        assert value in (*SPRINGS, *FRICTIONS, *Tap)
