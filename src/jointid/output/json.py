"""Results as JSON (`result.fields`), and estimates read back for later commands.

Every document has `schema`, the result's class with the number of the format, and the program's `version`.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from jointid import ClosedLoop, __version__
from jointid.common.document import Documented
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import digest, explain, open_file, write_whole
from jointid.config import File, load
from jointid.diagnostics.diagnosis import Diagnosis
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.fields import dumps, finite, plain, read
from jointid.models.joints import Joint

if TYPE_CHECKING:
    from jointid.estimation.saved import System
    from jointid.simulation.simulate import Simulation

__all__ = ["dumps", "load_estimate", "plain", "read_report", "simulation_answer", "to_dict"]

Json: TypeAlias = dict[str, Any]

ESTIMATE_SCHEMA = "jointid.Estimate/2"
REPORT_SCHEMA = "jointid.Report/2"
REPORT_ELEMENT = "jointid-answer"
"""The id of the element of a page that carries the document of its report."""

_LARGEST = 2**26  # bytes of a file: the page of a report on 25 s has 3 MB
_DAMAGE = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError, MethodError)
_REMEDY = "give what identify --json or report --html wrote"


def to_dict(result: object) -> Json:
    """Convert a result to a dict with `schema`, as `--json` writes it.

    Args:
        result: of `identify`, `validate`, `compare`, `diagnose`, `tune`, `learn_controller`, `inspect`.

    Raises:
        MethodError: it is no such result.

    Example:
        >>> import jointid as ji
        >>> law = ji.controller.Cascade(position_gain=100.0, velocity_gain=2000.0)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> reference = ji.excitation.trapezoids((0.1, 0.2), acceleration=2.0, travel=0.1, rest=0.1, sample_time=1e-3)
        >>> truth = {"inertia": 30.0, "viscous": 80.0, "coulomb": 15.0, "offset": 2.0}
        >>> record = ji.simulated_record(loop, reference, truth, sample_time=1e-3)
        >>> ji.to_dict(ji.identify(record, loop))["schema"]
        'jointid.Estimate/2'
    """
    if not isinstance(result, Documented):
        raise MethodError(f"Only a verb's result is written as JSON; received {type(result).__name__}: give that.")
    return {"schema": f"jointid.{type(result).__name__}/2", "version": __version__, **plain(result)}


def simulation_answer(simulation: Simulation, record: str, values: Mapping[str, object]) -> Json:
    """JSON document of a record's simulation, without signals, with other values."""
    return {
        "schema": "jointid.Simulation/2",
        "version": __version__,
        "record": record,
        "samples": len(simulation.torque),
        "sample_time": simulation.sample_time,
        "outcome": simulation.outcome.name.lower(),
        "explanation": simulation.outcome.value,
        "events": simulation.events,
        "peak_torque": plain(abs(simulation.torque).max(axis=0)),
        **plain(values),
    }


@contextlib.contextmanager
def _refuse_damage(path: str | os.PathLike[str]) -> Iterator[None]:
    """Refuse a document with a missing part or one of another type."""
    try:
        yield
    except RecordError:
        raise
    except _DAMAGE:
        raise RecordError(f"{path} is a damaged estimate; {_REMEDY}.") from None


def load_estimate(path: str | Path, system: File | System | str | Path) -> Estimate:
    """Load the estimate of a joint or a robot from a file.

    It predicts, is compared, validated, reported and exported as when it was identified. The measured and predicted
    torque, and the tests of them, are not in the file.

    Args:
        path: file of `Estimate.save`, `identify --json` or `report --html`.
        system: the identified system: a joint file or a robot file, or its path; or a joint or a robot, alone, under
            its controllers, or along its motor's motion. An estimate's file has no geometry; that of the robot must
            give the sums of parameters that the file states.

    Raises:
        RecordError: the file cannot be read, is no estimate, or belongs to another model or another side of its
            transmission; of a robot, or of several records with parameters of their own, a value is missing without
            which no torque can be predicted.

    Example:
        >>> import tempfile
        >>> import jointid as ji
        >>> axis = ji.twin("L19", noise="none")
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), axis.loop.controller)
        >>> estimate = ji.identify(axis.record, loop, filtering=ji.Filtering(cutoff=5.0), checks=False)
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     kept = ji.load_estimate(estimate.save(f"{folder}/kept.json"), loop)
        >>> kept["inertia"].value == estimate["inertia"].value
        True
    """
    from jointid.estimation.saved import RobotSystem, restore_estimate

    model, answer = load(system) if isinstance(system, str | Path) else system, read_report(path)
    model = model.setup if isinstance(model, File) else model
    try:
        with _refuse_damage(path):
            if isinstance(model, RobotSystem):
                return restore_estimate(answer, model)
            joint, loop = (model, None) if isinstance(model, Joint) else (model.joint, model)
            if not _fits(answer["settings"]["system"], plain(joint)):
                raise RecordError("it is of another joint, or of the other side of its transmission")
            if own := [p.name for p in joint.parameters if p.name not in answer["parameters"]]:
                raise RecordError(
                    f"it has no {', '.join(own)}, or one for each of its records, so it predicts no torque of another"
                )
            return restore_estimate(answer, joint, loop if isinstance(loop, ClosedLoop) else None)
    except RecordError as error:
        raise RecordError(f"{path} does not fit this model: {error}; identify with this file first.") from None


def _fits(stated: Any, own: Any) -> bool:
    """Test whether the joint of a document agrees with another one."""
    if isinstance(stated, dict):
        return isinstance(own, dict) and all(_fits(value, own.get(key)) for key, value in stated.items())
    return bool(stated == own)


def read_report(path: str | os.PathLike[str]) -> Json:
    """Read the document of an estimate from JSON or a report's page.

    Raises:
        RecordError: the file cannot be read, or holds no estimate.
    """
    path, damaged = Path(path), RecordError(f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.")
    with explain(path, "read", _REMEDY), open_file(path) as file:
        raw = file.read(_LARGEST + 1)
    if len(raw) > _LARGEST:
        raise damaged
    try:
        text = raw.decode("utf-8-sig")
        if text.lstrip()[:1] == "<":  # the page of a report, which carries its answer along
            text = text.partition(f'id="{REPORT_ELEMENT}"')[2].partition(">")[2].partition("</script>")[0]
        answer = json.loads(text, parse_constant=finite)  # NaN and Infinity are words here, and so refused
        answer = dict(answer.get("estimate", answer))
    except (AttributeError, TypeError, ValueError, RecursionError):
        raise damaged from None
    if answer.get("schema") != ESTIMATE_SCHEMA:
        raise damaged
    return answer


def key_of(file: File, records: Sequence[Path], axis: str | None, changes: Sequence[str], window: float | None) -> str:
    """SHA-256 of all inputs of an estimate: files, changes and this program."""
    model, cut = file.model_path, str(file.source)  # that of a part of a log is another than its file's
    models = [] if model is None else sorted(model.parent.glob(f"*{model.suffix}"))  # which may include each other
    said = [file.text, cut, file.method.name, axis, [*changes], window, digest(*records, *models), _digest_program()]
    return hashlib.sha256(json.dumps(said).encode()).hexdigest()


@cache
def _digest_program() -> str:
    return digest(*sorted(Path(__file__).parents[1].rglob("*.py")))


def recall(path: Path, file: File, key: str) -> Estimate | None:
    """Estimate kept with a key; None for a damaged or different file. A kept refusal is raised."""
    with contextlib.suppress(RecordError):
        answer = read_report(path)
        if answer.get("key") == key:
            if "refused" in answer:
                raise MethodError(str(answer["refused"]), str(answer.get("code") or ""))
            with _refuse_damage(path):
                x = read(tuple[float, ...] | None, answer["x"])
                made = read(Diagnosis | None, answer["diagnosis"])
                return replace(load_estimate(path, file), diagnosis=made, x=None if x is None else np.array(x))
    return None


def keep(path: Path, key: str, estimate: Estimate | None, **refusal: str) -> None:
    """Keep an estimate, or a refusal, with its key; refuse to overwrite other files."""
    if os.path.lexists(path) and "key" not in read_report(path):
        raise RecordError(f"{path} is an answer that was written there; move it.")
    answer: Json = {"schema": ESTIMATE_SCHEMA, "key": key, **refusal}
    if estimate is not None:
        answer |= to_dict(estimate) | {"x": plain(estimate.x), "diagnosis": plain(estimate.diagnosis, whole=True)}
        answer |= {} if estimate.robot is None else {"values": plain(estimate.robot.values)}  # of refused ones, too
    write_whole(path, dumps(answer))
