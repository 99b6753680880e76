"""A simulation and how it ended as JSON."""

from __future__ import annotations

from jointid.models.joints import Joint
from jointid.output.json.parts import Json, resampled_answer, transmission_answer
from jointid.records.record import Resampled
from jointid.simulation.closed_loop import Simulation

SIMULATION_SCHEMA = "jointid.simulation/1"


def simulation_answer(
    simulation: Simulation, joint: Joint, values: dict[str, float], record: str, resampled: Resampled | None = None
) -> Json:
    """Return what a simulation was and how it ended as it is written to JSON; the signals go into a record."""
    units = {p.name: joint.unit(p) for p in joint.parameters}
    return {
        "schema": SIMULATION_SCHEMA,
        "model": joint.model,
        "transmission": transmission_answer(joint.transmission),
        "record": record,
        "resampled": resampled_answer(resampled),
        "parameters": {
            p.name: {"symbol": p.symbol, "value": values[p.name], "unit": units[p.name]} for p in joint.parameters
        },
        "samples": int(simulation.torque.size),
        "sample_time": simulation.sample_time,
        "outcome": simulation.outcome.name.lower(),
        "explanation": simulation.outcome.value,
        "events": simulation.events,
        "at_limit_percent": 100 * simulation.at_limit,
        "peak_torque": float(abs(simulation.torque).max()),
    }
