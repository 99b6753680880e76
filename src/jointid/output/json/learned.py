"""A learned controller as JSON."""

from __future__ import annotations

from dataclasses import asdict

from jointid.config import controller_text
from jointid.controller_id.learned import Alternative, LearnedLoop
from jointid.models.controllers import Controller, numbers_of
from jointid.output.json.parts import Json, resampled_answer

LEARNED_SCHEMA = "jointid.learned_loop/1"


def learned_answer(learned: LearnedLoop) -> Json:
    """Return a learned controller as it is written to JSON."""
    return {
        "schema": LEARNED_SCHEMA,
        "record": learned.record,
        "resampled": resampled_answer(learned.resampled),
        "structure": str(learned.structure),
        "law": _law(learned.controller),
        "numbers": [asdict(one) for one in learned.numbers],
        "correlation": learned.correlation.tolist(),
        "equivalent": list(learned.equivalent_laws),
        "alternatives": [_alternative(one) for one in learned.alternatives],
        "sentences": [str(one) for one in learned.limitations],
        "residual": {"rms": learned.rms, "percent": 100 * learned.share, "unit": learned.torque_unit},
        "noise": {"torque": learned.torque_noise, "position": learned.position_noise, "heard_up_to_hz": learned.band},
        "table": controller_text(learned.controller, learned.transmission),
    }


def _alternative(one: Alternative) -> Json:
    return {
        "structure": str(one.structure),
        "law": _law(one.controller),
        "worse": one.worse,
        "apart_percent": 100 * one.apart,
        "alike": one.alike,
    }


def _law(controller: Controller) -> Json:
    return {"name": type(controller).__name__, "numbers": numbers_of(controller)}
