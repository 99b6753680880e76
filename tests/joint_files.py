"""What the tests of joint files share."""

from pathlib import Path

import pytest

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.config import loads


def faults(text: str) -> tuple[Fault, ...]:
    """Return the sentences with which a joint file is refused."""
    with pytest.raises(JointFileError) as caught:
        loads(text)
    return caught.value.faults


def told(text: str) -> list[str]:
    """Return place and code of each fault of a joint file."""
    return [f"{dot_path(fault.place)} {fault.code}".strip() for fault in faults(text)]


ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "emps" / "joint.toml"

JOINT = '[joint]\nkind = "prismatic"\n'
CHANNELS = """
[record.channels]
torque = { column = "i" }
reference = { column = "r" }
motor_position = { column = "q" }
"""
CASCADE = '[controller]\nlaw = "cascade"\nposition_gain = 100.0\nvelocity_gain = 2000.0\n'
SMALLEST = JOINT + CHANNELS + CASCADE
FLEXIBLE = SMALLEST.replace(JOINT, JOINT + 'model = "flexible"\n')


BOTH_ENCODERS = CHANNELS + 'load_position = { column = "p" }\n'
LINK = SMALLEST.replace("prismatic", "revolute") + '[gravity]\nload = "link"\n'


def in_our_words(error: JointFileError) -> None:
    for sentence in error.faults:
        assert sentence.endswith((".", "?"))
        assert "\n" not in sentence
