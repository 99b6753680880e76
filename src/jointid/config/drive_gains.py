"""Gains given by the names and in the units of a drive's parameters, from its profile."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jointid.common.errors import Fault, JointFileError
from jointid.common.messages import dot_path
from jointid.records.drives import load_profile, profile_names


def table_at(raw: Mapping[str, Any], *path: str) -> Mapping[str, Any]:
    """Return the raw table at a path, empty if there is none."""
    for key in path:
        below = raw.get(key)
        raw = below if isinstance(below, dict) else {}
    return raw


def translate_gains(raw: Mapping[str, Any]) -> Mapping[str, Any]:
    """Return the tables of a joint file with a drive's gains under the file's own keys.

    A plain number is in the parameter's unit, as the drive shows it; a time of 0, which turns an integral off, is left
    out.

    Args:
        raw: the tables as `tomllib` reads them; they stay as they are.

    Raises:
        JointFileError: a gain is given by both names, or needs its unit.
    """
    profile, controller = table_at(raw, "drive").get("profile"), table_at(raw, "controller")
    if profile not in profile_names() or not controller:
        return raw
    found, faults = dict(controller), list[Fault]()
    for gain in load_profile(profile).gains:
        if gain.name not in controller:
            continue
        value, place = found.pop(gain.name), ("controller", gain.name)
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if gain.key in found:
            rest = f" is {gain.key}, which stands beside it; expected one of them: leave one out."
            faults.append(Fault(f"{dot_path(place)}{rest}", place))
        elif number and len(gain.units) > 1:
            listed = " or ".join(f'"{value} {unit}"' for unit in gain.units)
            rest = f" is {value}, in a unit that the drive may have set; expected {listed}: add the unit."
            faults.append(Fault(f"{dot_path(place)}{rest}", place, "unit"))
        elif not (number and value == 0 and gain.key.endswith("_time")):
            found[gain.key] = f"{value!r} {gain.units[0]}" if number else value
    if faults:
        raise JointFileError(faults)
    return {**raw, "controller": found}


def keys_of_controller(raw: Mapping[str, Any]) -> set[str]:
    """Return the keys of [controller], with a drive's parameters under the file's own keys."""
    profile, controller = table_at(raw, "drive").get("profile"), table_at(raw, "controller")
    gains = load_profile(profile).gains if profile in profile_names() else ()
    return {*controller, *(gain.key for gain in gains if gain.name in controller)}
