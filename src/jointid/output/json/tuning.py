"""Tuning as JSON: margins, gains, notch, feed-forward, and the smallest detectable change."""

from __future__ import annotations

import math
from dataclasses import asdict

from jointid.output.json.parts import Json, transmission_answer
from jointid.tuning.margins import Margins
from jointid.tuning.minimum_detectable_change import MinimumDetectableChange
from jointid.tuning.tuned import LoopMargins, Tuned

TUNING_SCHEMA = "jointid.tuning/1"


def tuning_answer(tuned: Tuned) -> Json:
    """Return a tuning as it is written to JSON, angles in degrees.

    A margin that is null has no bound, or is of a loop that is not stable.
    """
    return {
        "schema": TUNING_SCHEMA,
        "record": tuned.record,
        "model": tuned.model,
        "transmission": transmission_answer(tuned.transmission),
        "interval": tuned.interval,
        "asked": {
            "gain_margin": tuned.settings.gain_margin,
            "phase_margin_degrees": tuned.settings.phase_margin,
            "distance_from_minus_one": tuned.settings.modulus,
            "confidence": tuned.settings.confidence,
        },
        "present": _loop(tuned.present),
        "proposed": None if tuned.proposed is None else _loop(tuned.proposed),
        "gains": [asdict(gain) for gain in tuned.gains],
        "notch": None
        if tuned.notch is None
        else {
            "frequency": tuned.notch.notch.frequency,
            "bandwidth": tuned.notch.notch.bandwidth,
            "depth": tuned.notch.notch.depth,
            "period": tuned.notch.period,
            "numerator": list(tuned.notch.numerator),
            "denominator": list(tuned.notch.denominator),
        },
        "feedforward": [asdict(one) for one in tuned.feedforward],
        "detectable": detectable_answer(tuned.detectable),
        "notes": list(tuned.notes),
    }


def detectable_answer(found: MinimumDetectableChange) -> Json:
    """Return what changes would be told as it is written to JSON."""
    return {
        "false_alarm": found.false_alarm,
        "power": found.power,
        "changes": [asdict(change) for change in found.changes],
    }


def _loop(loop: LoopMargins) -> Json:
    response = loop.response
    return {
        "estimate": _margins(loop.estimate),
        "worst": _margins(loop.worst),
        "crossover_hz": loop.crossover,
        "response": {
            "hertz": [float(value) for value in response.hertz],
            "size": [float(value) for value in abs(response.nominal)],
            "smallest": [float(value) for value in response.size[0]],
            "largest": [float(value) for value in response.size[1]],
            "phase_lowest_degrees": [math.degrees(value) for value in response.phase[0]],
            "phase_highest_degrees": [math.degrees(value) for value in response.phase[1]],
        },
    }


def _margins(found: Margins) -> Json:
    if not found.stable:  # it has no margins
        return {"stable": False} | dict.fromkeys(
            ("gain", "reduction", "phase_degrees", "delay", "distance_from_minus_one")
        )
    return {
        "stable": True,
        "gain": found.gain,
        "reduction": found.reduction,
        "phase_degrees": math.degrees(found.phase),
        "delay": found.delay,
        "distance_from_minus_one": found.modulus,
    }
