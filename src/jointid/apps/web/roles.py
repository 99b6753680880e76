"""Guess the channel of each column from its name; a proposal that is shown and can be changed."""

from __future__ import annotations

import re
from collections.abc import Iterable

from jointid.records.drives.drive import Profile, load_profile, profile_names
from jointid.records.record import CHANNELS

_PROFILE_FIRST = "generic"

_USUAL = {
    "time": ("t", "time", "timestamp", "time s", "zeit"),
    "torque": ("vir", "trq", "tq", "torque", "force", "tau", "i q", "iq", "current", "torque cmd", "cmd torque"),
    "reference": (
        "qg", "q ref", "ref", "x ref", "pos ref", "position reference", "pos cmd", "cmd pos", "command", "setpoint",
        "set point", "pos set", "reference", "q cmd", "q d", "qd", "target",
    ),
    "motor_position": (
        "qm", "q m", "q", "pos", "pos act", "act pos", "position", "enc", "encoder", "q motor", "motor position",
        "pos fbk", "phi m",
    ),
    "load_position": ("ql", "q l", "q load", "load position", "pos load", "load encoder", "phi l"),
    "injected": ("injected", "pulses", "excitation", "pulses n"),
}  # fmt: skip
"""What engineers call these signals where no drive named them: the EMPS record and its like."""

_HUMP = re.compile(r"(?<=[a-z])(?=[A-Z])")
_WORD = re.compile(r"[a-z0-9]+")
_BRACKETS = re.compile(r"\s*[\[(][^\[\]()]*[\])]\s*$")


def guess_roles(columns: Iterable[str]) -> dict[str, str]:
    """Return the column of each channel, and of "time", as far as exactly one of them is called so.

    Args:
        columns: names of the columns.
    """
    names = list(columns)
    found: dict[str, str] = {}
    for role in ("time", *CHANNELS):
        free = [name for name in names if name not in found.values()]
        column = _find_by_usage(role, free) or (None if role == "time" else _find_by_profile(role, free))
        if column is not None:
            found[role] = column
    return found


def _find_by_usage(role: str, names: list[str]) -> str | None:
    for usual in _USUAL.get(role, ()):
        called = [name for name in names if _normalise(name) == usual]
        if len(called) == 1:
            return called[0]
    return None


def _find_by_profile(channel: str, names: list[str]) -> str | None:
    for profile in _list_profiles():
        called = [name for name in names if profile.signals(channel, name, None) or profile.signals(channel, name, 1)]
        if len(called) == 1:
            return called[0]
    return None


def _list_profiles() -> list[Profile]:
    rest = [name for name in profile_names() if name != _PROFILE_FIRST]
    return [load_profile(name) for name in (_PROFILE_FIRST, *rest)]


def _normalise(name: str) -> str:
    return " ".join(_WORD.findall(_HUMP.sub(" ", _BRACKETS.sub("", name)).casefold()))
