"""Robots in a campaign: cases with a robot file.

The case's text has the absolute path and digest of the robot's model, so that another model makes another case.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping, Sequence
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
from jointid.estimation.methods.idim import IDIM
from jointid.estimation.result.answer import Trust
from jointid.estimation.robots.idim import KNOWN, RobotEstimate
from jointid.estimation.robots.torque_estimate import RobotTorqueEstimate
from jointid.records.record import Record
from jointid.simulation.robot_numbers import RobotNumbers
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
    if isinstance(estimate, RobotEstimate):
        settled, made = estimate.converged, 1
    else:
        settled, made = estimate.fit.converged, estimate.fit.iterations
    said: Mapping[str, Mapping[str, Any]] = estimate.rows
    found = {name: Found(finite(row["value"]), finite(row["std"]) or None, row["unit"]) for name, row in said.items()}
    known = [one for one in found.values() if one.value and one.std and one.std < KNOWN * abs(one.value)]
    asked = len(found) - (len(file.method.fixed) if isinstance(file.method, IDIM) else 0)
    left = 100 * estimate.joint_errors
    worst = file.robot.names[int(np.argmax(left))]
    objected = isinstance(estimate, RobotEstimate) and bool(estimate.objections)
    trust = Trust.NOT_YET if objected or not settled else Trust.NOT_CHECKED
    return {
        "outcome": Outcome.IDENTIFIED,
        "sentence": f"{len(known)} of {asked} parameters are known to a tenth; {max(left):.3g} % of the torque is "
        f"left, of {worst}.",
        "found": found,
        "trust": str(trust),
        "converged": bool(settled),
        "error_percent": finite(float(np.sqrt(np.mean(left**2)))),
        "simulations": int(made),
        "truth": {} if case.varied is None else dict(_truth(estimate)),
    }


def _truth(estimate: RobotEstimate | RobotTorqueEstimate) -> Iterator[tuple[str, float]]:
    """Yield the true identified combinations of a simulated robot.

    IDIM assumes rigid joints, so there is no truth where a joint has a spring.
    """
    robot = estimate.robot
    if isinstance(estimate, RobotTorqueEstimate):
        parameters = estimate.fit.parameters
        values = map(float, parameters.group(RobotNumbers.of(robot)))
        for name, place, value in zip(parameters.names, parameters.places, values, strict=True):
            if not place.is_of_record:
                yield name, value
    elif not any(robot.flexible):
        yield from zip(estimate.names, map(float, estimate.base.with_friction(robot)), strict=True)


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
