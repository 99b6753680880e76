"""An estimate back from its file, as far as a later command needs it: JSON, or the page of a report."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jointid import ClosedLoop
from jointid.common.document import optional_number
from jointid.common.errors import MethodError, RecordError
from jointid.common.files import open_file
from jointid.config import File
from jointid.diagnostics.compare_estimates import ReportedEstimate, ReportedQuantity
from jointid.estimation.methods.registry import METHODS
from jointid.estimation.result.estimate import Estimate
from jointid.models.disturbances import effect_parameters
from jointid.models.friction import FRICTIONS
from jointid.models.joints import Joint
from jointid.output.json.documents import REPORT_ELEMENT, REPORT_SCHEMA, plain
from jointid.output.json.estimates import EFFECTS, ESTIMATE_SCHEMA, Json

if TYPE_CHECKING:
    from jointid.estimation.saved import RobotSystem, System

_LARGEST = 2**26  # bytes of a file: the page of a report on 25 s has 3 MB
_DAMAGE = (ArithmeticError, AssertionError, AttributeError, LookupError, TypeError, ValueError, MethodError)
_REMEDY = "give the file that identify --json wrote"
_REMEDY_OF_REPORT = "give what identify --json or report --html wrote"


def load_estimate(path: str | Path, system: File | System) -> Estimate:
    """Return the estimate of a joint or a robot from the file that keeps it.

    It predicts, is compared, validated, reported and exported as when it was identified. The measured and predicted
    torque, and the tests of them, are not in the file.

    Args:
        path: what `Estimate.save`, `identify --json` or `report --html` wrote.
        system: what was identified: a joint file or a robot file from `load`, or a joint or a robot, alone, under its
            controllers, or along the motion of its motor. Geometry is not in the file of an estimate; that of the robot
            must give the sums of parameters that the file states.

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
    from jointid.estimation.saved import RobotSystem

    model, answer = system.setup if isinstance(system, File) else system, read_answer(path)
    if isinstance(model, RobotSystem):
        return _read_robot(path, answer, model)
    joint, loop = (model, None) if isinstance(model, Joint) else (model.joint, model)
    if answer.get("schema") == ESTIMATE_SCHEMA and answer.get("model") == "robot":
        raise RecordError(f"{path} is the estimate of a robot; expected that of one joint: {_REMEDY}.")
    if (stated := answer.get("transmission")) != (declared := plain(joint.transmission)):
        raise RecordError(
            f"{path} was identified with {_gear_text(stated)}, and this joint has {_gear_text(declared)}; correct "
            "[transmission], or identify with this joint file first."
        )
    found, several = answer.get("parameters"), isinstance(answer.get("records"), list)
    stated = found if several and isinstance(found, dict) else None
    if own := [p.name for p in joint.parameters if stated is not None and p.name not in stated]:
        raise RecordError(
            f"{path} has {', '.join(own)} of each of its records, so it predicts no torque of another; identify these "
            "records without own."
        )
    try:
        return _build_joint(answer, joint, loop if isinstance(loop, ClosedLoop) else None)
    except _DAMAGE:
        raise RecordError(
            f"{path} is no estimate of schema {ESTIMATE_SCHEMA} for a {joint.kind} {joint.model} joint with these "
            "parameters in these units; identify with this joint file first."
        ) from None


def _read_robot(path: str | Path, answer: Json, system: RobotSystem) -> Estimate:
    from jointid.estimation.saved import build_estimate

    if answer.get("schema") != ESTIMATE_SCHEMA or answer.get("model") != "robot":
        raise RecordError(f"{path} is no estimate of a robot; {_REMEDY}.")
    try:
        return build_estimate(answer, system)
    except RecordError as error:
        raise RecordError(f"{path} does not fit this robot: {error}.") from None
    except _DAMAGE:
        raise RecordError(f"{path} is a damaged estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.") from None


def _gear_text(transmission: object) -> str:
    """Return a transmission of an answer in words."""
    if not isinstance(transmission, dict):
        return "no transmission"
    ratio, side = transmission.get("motor_per_load"), transmission.get("side")
    return f"a transmission of {ratio} motor per load, on the {side} side"


def read_choices(path: str | Path) -> dict[str, str]:
    """Return the choices of an estimate: friction law of a joint, method of a robot.

    Raises:
        RecordError: the file is no estimate.
    """
    answer = read_answer(path)
    robot = answer.get("schema") == ESTIMATE_SCHEMA and answer.get("model") == "robot"
    key, known = ("method", [*METHODS]) if robot else ("friction", [*FRICTIONS])
    choice = answer.get(key)
    if choice not in known:
        raise RecordError(f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY}.")
    return {key: str(choice)}


def read_answer(path: str | os.PathLike[str], remedy: str = _REMEDY) -> Json:
    """Return the answer in a file, whatever it is of: in JSON, or carried along by the page of a report.

    Of a report it is its estimate.

    Raises:
        RecordError: the file cannot be read, or holds no JSON object; the sentence ends with the remedy.
    """
    path = Path(path)
    try:
        with open_file(path) as file:
            raw = file.read(_LARGEST + 1)
        if len(raw) > _LARGEST:
            size = max(path.stat().st_size, len(raw))
            raise RecordError(f"{path} has {size} bytes, which no answer has (at most {_LARGEST}); {remedy}.")
        text = raw.decode("utf-8-sig")
        if text.lstrip()[:1] == "<":  # the page of a report, which carries its answer along
            text = text.partition(f'id="{REPORT_ELEMENT}"')[2].partition(">")[2].partition("</script>")[0]
        answer = json.loads(text, parse_constant=_no_number)
    except OSError as error:
        raise RecordError(f"{path} cannot be read ({error.strerror}); {remedy}.") from None
    except (ValueError, RecursionError):
        raise RecordError(f"{path} is no JSON file; {remedy}.") from None
    if isinstance(answer, dict) and answer.get("schema") in (REPORT_SCHEMA, "jointid.robot_report/1"):
        answer = answer.get("estimate")
    if not isinstance(answer, dict):
        raise RecordError(f"{path} is no estimate of schema {ESTIMATE_SCHEMA}; {remedy}.")
    return answer


def _fingerprints(answer: Json) -> tuple[str, ...]:
    """Return the fingerprints of the torque of each record of an estimate, or of each log of a robot."""
    record = answer["record"]
    each = [one["torque_sha256"] for one in answer.get("records") or (record,)]
    return tuple(str(one) for one in record.get("logs_sha256") or each if one)


def _no_number(name: str) -> float:
    """Refuse NaN and Infinity, which no answer holds and JSON does not know."""
    raise ValueError(name)


def _build_joint(answer: Json, joint: Joint, loop: ClosedLoop | None) -> Estimate:
    from jointid.estimation.saved import build_estimate

    found = answer["parameters"]
    same = answer["schema"] == ESTIMATE_SCHEMA and (answer["model"], answer["kind"]) == (joint.model, joint.kind)
    same = same and all(answer.get(part) == plain(getattr(joint, part)) for part in ("gravity", "ripple"))
    effects = tuple(EFFECTS[given.pop("kind")](**given) for given in map(dict, answer.get("effects", [])))
    every = (*joint.parameters, *effect_parameters(effects))
    if (
        not same
        or any(found[p.name]["unit"] != joint.unit(p) for p in joint.parameters)
        or {p.name for p in every} - set(found)
    ):
        raise ValueError
    law = str(answer["controller_sha256"] or "")
    return build_estimate(answer, joint, loop, effects=effects, controller=law)


def read_report(path: str | Path) -> ReportedEstimate:
    """Return the estimate in a file: the JSON of an estimate or of a report, or the HTML page of a report.

    Raises:
        RecordError: the file cannot be read, or holds no estimate.
    """
    path = Path(path)
    answer = read_answer(path, _REMEDY_OF_REPORT)
    if answer.get("schema") != ESTIMATE_SCHEMA:
        raise RecordError(f"{path} holds no estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY_OF_REPORT}.")
    try:
        return _build_report(answer, path.name)
    except (KeyError, TypeError, ValueError, AttributeError, OverflowError):
        raise RecordError(f"{path} is a damaged estimate of schema {ESTIMATE_SCHEMA}; {_REMEDY_OF_REPORT}.") from None


def _build_report(answer: Json, label: str) -> ReportedEstimate:
    record, robot, gear, filtering = (
        answer["record"],
        answer.get("robot"),
        answer.get("transmission"),
        answer["filtering"],
    )
    side = "" if gear is None else f"{gear['side']} side, {float(gear['motor_per_load']):g} motor per load"
    settings = {
        "method": str(answer["variant"]),
        "filter": f"{filtering['cutoff']} Hz, one sample in {filtering['decimation']}",
        "samples left out": " + ".join(str(int(border)) for border in filtering["borders"]),
    }
    if robot is None:
        settings["controller"] = str(answer["controller_sha256"] or "none")[:12]
        kind, friction = str(answer["kind"]), str(answer["friction"])
    else:
        kind, friction = f"{robot['name']} of {', '.join(map(str, robot['joints']))}", ""
    quantities = tuple(
        _quantity(_name_of_sum(name, p), "symbol", p, free=bool(p["free"]))
        for name, p in _every_parameter(answer).items()
        if (robot is None or p["axis"]) and not name.rpartition(".")[2].startswith("initial_")
    )
    sums = [one for one in answer.get("combinations") or () if _of_both_sides(one["weights"])]
    return ReportedEstimate(
        label, str(record["name"]), _fingerprints(answer), str(answer["model"]), kind, friction, side,
        str(record["torque_unit"]), settings, _share(answer["relative_error_percent"]), quantities,
        tuple(_quantity(str(one["name"]), "formula", one) for one in sums),
    )  # fmt: skip


def _every_parameter(answer: Json) -> Json:
    """Return the parameters of an estimate, those of a record by itself with its number."""
    own = [(k, one["parameters"]) for k, one in enumerate(answer.get("records") or (), 1)]
    more = {f"{name}@{k}": {**p, "symbol": f"{p['symbol']}@{k}"} for k, each in own for name, p in each.items()}
    return {**answer["parameters"], **more}


def _share(percent: object) -> float | None:
    number = optional_number(percent)
    return None if number is None else number / 100


def _name_of_sum(name: str, p: Mapping[str, Any]) -> str:
    """Return a name with what else is in its sum, of a robot: by two methods the same name may have other sums."""
    others = [one for one in re.findall(r"(?<!\w)[A-Za-z][\w+-]*", str(p.get("formula", ""))) if one != p["symbol"]]
    return f"{name} with {', '.join(sorted(others))}" if others else name


def _of_both_sides(weights: Mapping[str, float]) -> bool:
    """Return whether weights are the sum or difference of one quantity on both sides."""
    (first, one), *rest = weights.items()
    side, _, quantity = first.partition("_")
    return side == "motor" and one == 1.0 and len(rest) == 1 and rest[0] in {(f"load_{quantity}", w) for w in (1, -1)}


def _quantity(name: str, symbol: str, p: Mapping[str, Any], **further: bool) -> ReportedQuantity:
    """Return a parameter or combination of a document; `symbol` is the key of its symbol."""
    value, std = optional_number(p["value"]), optional_number(p["std"])
    return ReportedQuantity(name, str(p[symbol]), str(p["unit"]), value, std, **further)
