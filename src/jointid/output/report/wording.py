"""Words of a report for what results call by the names of their keys."""

from __future__ import annotations

import re

_SUSPECTS = {
    "gain": "gain of the controller's output",
    "log_gain": "size of the logged torque",
    "delay": "delay of the torque",
    "log_delay": "delay of the log",
    "stribeck": "friction that rises towards standstill",
    "presliding": "friction that falls towards standstill",
    "cubic_spring": "spring that is not linear",
    "load_dependent_friction": "friction that grows with the load's torque",
    "changing_friction": "friction that falls over the record",
    "winding_friction": "friction that winds up behind each reversal",
    "second_mode": "load that swings in itself",
    "cogging": "force that comes back with the position",
    "limit": "limit of the controller's output",
    "offset": "constant force",
    "injected_gain": "size of the injected signal",
    "present_sample": "integral that takes in the present sample",
    "measured_velocity": "velocity that is no difference of positions",
    "period": "period of the controller",
}
_KEY = re.compile(r"\b[a-z]+(?:_[a-z]+)+\b")


def suspect(name: str) -> str:
    """Return a fault of loop or log in words: "velocity gain", "delay of the log"."""
    one_by_one = (_SUSPECTS.get(one, one.replace("_", " ").replace(".", " ")) for one in name.split(" and "))
    return " and ".join(one_by_one)


def say_suspects(text: str) -> str:
    """Return a text with the keys in it in words."""
    return _KEY.sub(lambda found: suspect(found[0]), text)


def sentence(text: str) -> str:
    """Return a text as a sentence of its own."""
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith('.') else '.'}"
