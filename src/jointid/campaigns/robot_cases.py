"""Robots in a campaign: cases with a robot file.

The case's text has the absolute path and digest of the robot's model, so that another model makes another case.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w

from jointid.campaigns.cases import Case, Found, Outcome, Simulated, finite
from jointid.common.errors import JointFileError, MethodError
from jointid.config import loads
from jointid.config.loading import parse_toml
from jointid.config.robot_file import RobotFile
from jointid.estimation.result.estimate import Estimate
from jointid.records.record import Record
from jointid.simulation.simulated import require_success
from jointid.simulation.synthesis import simulate


def embed_model(text: str, folder: Path) -> str:
    """Return the text of a file for a case, with absolute path and digest of a robot's model."""
    try:
        tables = parse_toml(text)
    except JointFileError:
        return text  # whose fault loading it says
    if "robot" not in tables:
        return text
    model = tables["robot"].get("model") if isinstance(tables["robot"], dict) else None
    if not isinstance(model, str) or not (folder / model).is_file():
        return text  # likewise
    path = (folder / model).absolute()
    tables["robot"]["model"] = str(path)
    digest = hashlib.sha256(path.read_bytes()).hexdigest()
    return f"# the model's SHA-256: {digest}\n{tomli_w.dumps(tables)}"


def record_of(text: str, changes: Sequence[str] = ()) -> str | None:
    """Path of the record that a joint file or a robot file names."""
    source = loads(text, changes=changes).source
    return None if source.file is None else str(source.file)


def identify_robot_case(case: Case, file: RobotFile, path: Path) -> dict[str, Any]:
    """Identify a robot; return the entries of a row with its parameters.

    Args:
        case: whose joint file is a robot file.
        file: the robot file with the changes of the case.
        path: of its record.
    """
    if case.varied is not None and not isinstance(case.varied, Simulated):
        raise MethodError(
            f"A robot's runs are logged or simulated; received one that is {case.varied.kind}: use [fleet] or "
            "[monte_carlo]."
        )
    records = file.record(path) if case.varied is None else _simulate(file, file.driving(path), case.varied)
    estimate = file.identify(records)
    rows = estimate.params.rows
    return {
        "outcome": Outcome.IDENTIFIED,
        "sentence": estimate.sentence,
        "found": {row.name: Found(finite(row.value), finite(row.stderr), row.unit) for row in rows},
        "trust": str(estimate.answer.trust.code),
        "converged": bool(estimate.fit.converged),
        "error_percent": finite(100 * estimate.fit.filtered_error),
        "simulations": int(estimate.fit.simulations),
        "truth": {} if case.varied is None else dict(_truth(estimate)),
    }


def _truth(estimate: Estimate) -> Iterator[tuple[str, float]]:
    """Yield the true identified combinations of a simulated robot; none where the method does not know them."""
    part = estimate.require_robot()
    values = part.parameters_of(part.model)
    if values is not None:
        named = zip(estimate.params.rows, map(float, values), strict=True)
        yield from ((row.name, value) for row, value in named if row.of_joint)


def _simulate(file: RobotFile, driven: Sequence[Record], asked: Simulated) -> tuple[Record, ...]:
    """Records of a simulated run, with noise relative to the torques."""
    if asked.values or asked.noise_force:
        raise MethodError(
            "A robot's simulated runs have the numbers of its robot file and noise_log, of the joint with the largest "
            "torque and of the others in proportion; leave values and noise_force out of [monte_carlo]."
        )
    run = require_success(simulate(file.loop, driven), f"The simulation of {file.robot.name}")
    sizes = np.std(run.torque, axis=0)
    noise = np.random.default_rng([asked.seed]).standard_normal(run.torque.shape)
    torque = run.torque + asked.noise_log * noise * sizes / np.max(sizes)
    return replace(run, torque=torque).records(driven)
