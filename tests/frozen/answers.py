"""Answers: what is compared of a result, and what differs between two of them."""

import math
import os
import time
from typing import Any

import jointid as ji
from tests.frozen.cases import every

WITHIN, SPREAD, EXACT = 0.1, 0.05, 1e-6  # of a deviation; of the deviations; of values of real records
UNKNOWN = 1e6  # times the value: a deviation above that says nothing, and neither does the value
_OF_CAUSES = ("loop", "repeatable residual", "fit")


def number(value: float | None) -> float | None:
    """Return a number with the digits that are compared."""
    return None if value is None or not math.isfinite(value) else float(f"{value:.9g}")


def answer_of(result: Any) -> dict[str, Any]:
    """Return what is compared of a result."""
    if isinstance(result, ji.Estimate):
        rows = {
            row.name: [number(row.value), number(row.stderr)] for row in result.rows if row.free and "@" not in row.name
        }
        bounds = [number(bound.stiffness) for bound in result.bounds]
        return {"values": rows, "trust": str(result.answer.trust.code), "bounds": bounds, "cause": first_cause(result)}
    if isinstance(result, ji.robots.Robot):
        return {"values": {joint.name: [number(joint.rotor_inertia), None] for joint in result.joints}}
    if hasattr(result, "numbers"):  # of a learned controller
        numbers = {one.name: [number(one.value), number(one.std)] for one in result.numbers}
        return {"values": numbers, "trust": str(result.structure)}
    return {"values": {one.name: [float(one.rows), None] for one in result.channels}}


def first_cause(estimate: ji.Estimate) -> str:
    """Return the name of the first cause that the checks name; the code of the reason where it has no name."""
    failed = {str(one.name): one for one in reversed(estimate.checks) if one.passed is False}
    first = next((failed[subject] for subject in _OF_CAUSES if subject in failed), None)
    if first is None:
        return ""
    causes = first.values.get("causes") or [{"cause": first.values.get("suspect") or str(first.code)}]
    return str(causes[0]["cause"])


def run_case(name: str, folder: str) -> tuple[str, dict[str, Any], float]:
    """Return the name of a case, its answer and the seconds of processor."""
    os.chdir(folder)
    began = time.process_time()
    try:
        answer = answer_of(dict(every())[name]())
    except ji.JointidError as error:
        answer = {"values": {}, "trust": f"refused: {type(error).__name__}"}
    except Exception as error:
        answer = {"values": {}, "trust": f"crash: {type(error).__name__}: {error}"[:200]}
    return name, answer, time.process_time() - began


def differences(name: str, old: dict[str, Any], new: dict[str, Any]) -> list[str]:
    """Return what differs between two answers, a sentence each."""
    found = [f"{key}: {old.get(key)} -> {new.get(key)}" for key in ("trust", "cause") if old.get(key) != new.get(key)]
    before, after = old["values"], new["values"]
    if before.keys() != after.keys():
        found.append(f"values of {sorted(before.keys() ^ after.keys())} are in one answer alone")
    exact = name.startswith("real ")
    for row in before.keys() & after.keys():
        (value, std), (now, spread) = before[row], after[row]
        if min((std or 0.0) / UNKNOWN, (spread or 0.0) / UNKNOWN) > max(abs(value or 0.0), abs(now or 0.0)):
            continue
        size = max(abs(value or 0.0), std or 0.0)
        allowed = EXACT * size if exact or std is None else WITHIN * std
        if (value is None) != (now is None) or abs((value or 0.0) - (now or 0.0)) > max(allowed, 1e-9 * size):
            found.append(
                f"{row}: {value} -> {now}" + (f" ({(now - value) / std:+.2f} deviations)" if std and now else "")
            )
        if (std is None) != (spread is None) or abs((std or 0.0) - (spread or 0.0)) > SPREAD * (std or 0.0):
            found.append(f"deviation of {row}: {std} -> {spread}")
    bounds, known = new.get("bounds", []), old.get("bounds", [])
    pairs = zip(known, bounds, strict=False)
    if len(known) != len(bounds) or any(abs((a or 0.0) - (b or 0.0)) > SPREAD * abs(a or 0.0) for a, b in pairs):
        found.append(f"bounds: {known} -> {bounds}")
    return found
