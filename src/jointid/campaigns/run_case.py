"""Execution of a case: a pure function from description to row."""

from __future__ import annotations

import platform
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import cache, lru_cache
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jointid import Estimate, Record, __version__, simulated_record
from jointid.campaigns.addresses import digest, fetch
from jointid.campaigns.cases import Case, Found, Outcome, Redrawn, Row, Simulated, Started, finite
from jointid.common.arrays import FloatArray
from jointid.common.errors import JointidError, MethodError, RecordError
from jointid.config import JointFile, loads, require_joint
from jointid.config.robot_file import RobotFile
from jointid.simulation.simulated import require_success
from jointid.simulation.synthesis import simulate
from jointid.uncertainty.covariance import bandwidth
from jointid.uncertainty.identifiability import Kind, Known
from jointid.uncertainty.resampling import BANDWIDTHS


def run_case(case: Case) -> Row:
    """Identify a case and return its row; failures become sentences.

    Example:
        >>> from jointid.campaigns.cases import Case
        >>> from jointid.campaigns.run_case import run_case
        >>> row = run_case(Case("axis 1", "[joint]", "axis-1.csv", ""))
        >>> print(row.outcome, row.sentence)
        refused axis-1.csv cannot be opened (no such file or directory); check the path.
    """
    about: dict[str, Any] = {"versions": versions()}
    read = case.record
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            if case.program != __version__:
                raise RecordError(
                    f"The case was described by jointid {case.program}, and the worker has {__version__}; install the "
                    "same on both."
                )
            with fetch(case.record) as path:
                read = str(path)
                about["record_sha256"] = digest(path)
                return Row.of(case, **_identify(case, path, about["record_sha256"]), **about)
        except JointidError as error:
            return Row.of(case, Outcome.REFUSED, str(error).replace(read, case.record), **about)
        except Exception as error:
            sentence = f"jointid failed, which is a fault of ours ({type(error).__name__}: {error})."
            return Row.of(case, Outcome.FAILED, sentence, **about)


@cache
def versions() -> dict[str, str]:
    """Versions of jointid, Python and numerical libraries."""
    return {
        "jointid": __version__,
        "python": platform.python_version(),
        **{name: version(name) for name in ("numpy", "scipy", "numba")},
    }


@lru_cache(maxsize=64)
def _file(text: str, changes: tuple[str, ...]) -> JointFile | RobotFile:
    return loads(text, changes=changes)


@lru_cache(maxsize=8)
def _explain(text: str, changes: tuple[str, ...], path: Path, record_sha256: str) -> tuple[FloatArray, FloatArray]:
    """Explained torque and residual of a record's identification, (samples,) each."""
    file = require_joint(_file(text, changes), "A bootstrap")
    record = file.record(path)
    fit = file.identify(record, checks=False).fit
    if fit.compared != "torque" or record.torque is None or fit.predicted.size != len(record.torque):
        raise MethodError(
            "A bootstrap draws what is left of the torque anew, sample by sample; received a method that does not "
            "give it so: use didim or idim on a uniform record."
        )
    return fit.predicted, fit.measured - fit.predicted


def _identify(case: Case, path: Path, record_sha256: str) -> dict[str, Any]:
    """Entries of a row from an estimate."""
    starts = case.varied.starts if isinstance(case.varied, Started) else ()
    changes = [f"parameters.{name}.start={value!r}" for name, value in starts]
    file = _file(case.joint_file, (*case.settings, *case.changes, *changes))
    if file.runs:
        raise MethodError(
            f"The joint file of {case.joint} lists several [[records]], and a campaign identifies from one at a time; "
            "leave them out."
        )
    vary: Any = _vary_joint if isinstance(file, JointFile) else _vary_robot
    estimate = file.identify(vary(case, file, path, record_sha256))
    of_robot = estimate.robot is not None  # of which every number counts, those of its logs, too
    found = {
        p.name: Found(finite(p.value), finite(p.stderr) if p.free else None, p.unit)
        for p in estimate.params.rows
        if p.of_joint or of_robot
    }
    found |= {name: Found(finite(one.value), finite(one.std), one.combination.unit) for name, one in _totals(estimate)}
    truth: Iterator[tuple[str, float]] = iter(())
    if isinstance(case.varied, Simulated):
        truth = _robot_truth(estimate) if of_robot else _truth(estimate, case.varied)
    return {
        "outcome": Outcome.IDENTIFIED,
        "sentence": estimate.sentence,
        "found": found,
        "trust": str(estimate.answer.trust.code),
        "converged": bool(estimate.fit.converged),
        "error_percent": finite(100 * estimate.fit.filtered_error),
        "simulations": int(estimate.fit.simulations),
        "truth": dict(truth),
    }


def _vary_joint(case: Case, file: JointFile, path: Path, record_sha256: str) -> Record:
    """Return the record of a case: as logged, simulated, or with its error drawn anew."""
    record = file.record(path)
    if isinstance(case.varied, Simulated):
        return _simulate_joint(file, record, case.varied)
    if isinstance(case.varied, Redrawn):
        explained, left = _explain(case.joint_file, case.changes, path, record_sha256)
        length = min(BANDWIDTHS * bandwidth(left.size), left.size)
        begins = np.random.default_rng([case.varied.seed]).integers(left.size, size=-(-left.size // length))
        at = (begins[:, np.newaxis] + np.arange(length)).ravel()[: left.size]
        assert record.torque is not None
        torque = replace(record.torque, values=explained + np.take(left, at, mode="wrap"))
        return replace(record, torque=torque)
    return record


def _simulate_joint(file: JointFile, motion: Record, asked: Simulated) -> Record:
    """Return a simulated run of the motion of a record, with noise."""
    loop, reference = file.loop, motion.reference
    if loop is None or reference is None:
        raise MethodError(
            "A simulated run needs the controller and a reference; add [controller] and the channel reference to the "
            "joint file."
        )
    # Two streams, so that one noise is the same whether or not there is the other.
    force, log = (np.random.default_rng([asked.seed, k]).standard_normal(len(reference)) for k in range(2))
    injected = motion.injected
    more: dict[str, Any] = {}
    if injected is not None:
        more = {"injected": injected.channel.values, "at": injected.at, "in_torque": injected.in_torque}
    if motion.reference_velocity is not None:
        more["reference_velocity"] = motion.reference_velocity.values
    return simulated_record(
        loop, reference.values, dict(asked.values), sample_time=reference.sample_time, tap=motion.tap,
        disturbance=asked.noise_force * force if asked.noise_force else None,
        torque_noise=asked.noise_log * log if asked.noise_log else None, name=motion.name, **more,
    )  # fmt: skip


def _truth(estimate: Estimate, asked: Simulated) -> Iterator[tuple[str, float]]:
    """Yield true values of the identified quantities, if the model is the simulated one."""
    values = dict(asked.values)
    for p in estimate.params.rows:
        if p.of_joint and p.name in values:
            yield p.name, values[p.name]
    for name, one in _totals(estimate):
        weights = one.combination.weights
        if weights.keys() <= values.keys():
            yield name, sum(weight * values[each] for each, weight in weights.items())


def _totals(estimate: Estimate) -> Iterator[tuple[str, Known]]:
    """Yield the sums of both sides, identifiable where their parts are not."""
    known = estimate.checks.known
    for one in () if known is None else known.physical:
        if one.combination.kind is Kind.SUM:
            yield f"total_{one.combination.quantity}", one


def _vary_robot(case: Case, file: RobotFile, path: Path, _: str) -> tuple[Record, ...]:
    """Return the records of a case: as logged, or simulated."""
    if case.varied is None:
        return file.record(path)
    if not isinstance(case.varied, Simulated):
        raise MethodError(
            f"A robot's runs are logged or simulated; received one that is {case.varied.kind}: use [fleet] or "
            "[monte_carlo]."
        )
    return _simulate_robot(file, file.driving(path), case.varied)


def _robot_truth(estimate: Estimate) -> Iterator[tuple[str, float]]:
    """Yield the true identified combinations of a simulated robot; none where the method does not know them."""
    part = estimate.require_robot()
    values = part.parameters_of(part.model)
    if values is not None:
        named = zip(estimate.params.rows, map(float, values), strict=True)
        yield from ((row.name, value) for row, value in named if row.of_joint)


def _simulate_robot(file: RobotFile, driven: Sequence[Record], asked: Simulated) -> tuple[Record, ...]:
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
