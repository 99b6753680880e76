"""How the package is asked, and where in its answers a number is found.

This module alone imports jointid, spells its names, commands, options and keys, and reads its answers. When those are
renamed, it is changed, so that it gives the cases what it gave them before, and nothing else is.

Answers leave it as dicts and lists of numbers, booleans and short codes; sentences never do, only how many there are.
"""

from __future__ import annotations

import contextlib
import csv
import io
import json
import math
import re
import tomllib
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeAlias
from unittest.mock import patch
from xml.etree import ElementTree as ET
from zlib import crc32

import numpy as np
import tomli_w

import jointid as ji
from jointid.apps.cli import main
from jointid.apps.web import worker
from jointid.campaigns.campaign_file import load_campaign
from jointid.campaigns.folder import Results
from jointid.campaigns.report import CampaignReport, export_rows
from jointid.campaigns.run import run_case
from jointid.config import load_joint
from jointid.diagnostics.report_data import collect_report_data as collect
from jointid.models.disturbances import Drift
from jointid.models.linear import frequency_response
from jointid.models.position_forces import PositionHarmonics
from jointid.output.export import read_joint_model
from jointid.paper.published import TABLES
from jointid.paper.recomputed import compare_table as recomputed
from jointid.paper.recomputed import find_misprints
from jointid.paper.reproduce import ERRATA, reproduce
from jointid.planning.predict import planned_record, predict_test
from jointid.records.resampling import Resampling
from jointid.simulation.closed_loop import Initial, simulate_many
from jointid.simulation.loop_input import prepare
from jointid.simulation.sensitivities import simulate_sensitivities
from jointid.simulation.warm_up import warm_up
from jointid.uncertainty.resampling import Bootstrapping
from studies.servo import servo_twin

Json: TypeAlias = dict[str, Any]

ROOT = Path(__file__).resolve().parents[2]

EXAMPLES = {
    "emps": ROOT / "examples" / "emps" / "joint.toml",
    "motorbench": ROOT / "examples" / "motorbench" / "joint.toml",
    "kr300": ROOT / "examples" / "kr300" / "axis1.toml",
    "twin": ROOT / "examples" / "twin" / "joint.toml",
    "twin_rigid": ROOT / "examples" / "twin" / "rigid.toml",
}
"""The joint files that come with the package."""

MODEL = ROOT / "examples" / "kr300" / "kr300.xml"
"""The model of a robot that comes with the package."""

VARIANTS: Mapping[str, Json] = {
    "flexible": {"joint": {"model": "flexible"}},
    "asymmetric": {"joint": {"friction": "asymmetric"}},
    "paper_rigid": {"method": {"name": "didim", "preset": "paper"}},
    "regular_start": {"method": {"name": "didim", "start": "regular"}},
    "grid": {"method": {"frequency": None}},
    "nelder_mead_short": {
        "method": {"minimiser": "nelder-mead", "frequency": 30.0, "simulations": 400, "restarts": 0},
    },
    "inverse_model_statistics": {"method": {"statistics": "inverse-model"}},
    "free_gains": {"method": {"free": ["position_gain", "velocity_gain"]}},
    "free_log_delay": {"method": {"free": ["log_delay"]}},
    "free_log_gain": {"method": {"free": ["log_gain"]}},
    "free_delay": {"method": {"free": ["delay"]}},
    "fixed_damping": {"parameters": {"damping": {"value": 0.0}}},
    "idim": {"method": {"name": "idim", "frequency": None}},
    "idim_weighted": {"method": {"name": "idim", "estimator": "weighted", "frequency": None}},
    "both_encoders": {
        "record": {"channels": {"load_position": {"column": "theta_my", "unit": "rad", "sign": -1}}},
        "method": {"name": "idim"},
    },
    "heavier": {
        "records": [
            {"file": "twin.csv"},
            {"file": "twin_heavier.csv", "added_inertia": 10.0},
        ],
    },
    "wrong_gain": {"controller": {"position_gain": "200 1/s"}},
    "wrong_sign": {"record": {"channels": {"torque": {"sign": -1}}}},
    "wrong_limit": {"controller": {"limit": "2 V"}},
    "with_pulses": {"records": [{"file": "emps.mat"}, {"file": "emps_pulses.mat"}]},
}
"""What is changed in a joint file, by the name under which cases ask for it; None takes a key away."""

CODES: Mapping[str, str] = {}
"""Codes of today to those of golden.json, where a word of an answer was renamed since."""

NAMES: Mapping[str, str] = {}
"""Names of parameters of today to those of golden.json, where one was renamed since."""


class Refused(Exception):  # noqa: N818
    """A command refused what it was given."""


FAILURES = (ji.JointidError, Refused)

_MISTAKE = 2
"""The exit code of a command that refuses."""


# What every answer has


def number(value: Any) -> Any:
    """Return a number as JSON has it: None for one that is none, a word for an infinite one."""
    if value is None or isinstance(value, bool | np.bool_):
        return None if value is None else bool(value)
    value = float(f"{float(value):.13g}")  # more than is compared
    if math.isnan(value):
        return None
    if math.isinf(value):
        return "inf" if value > 0 else "-inf"
    return int(value) if value.is_integer() and abs(value) < 1e15 else value


def numbers(values: Any) -> list[Any]:
    """Return an array, of any number of dimensions, as lists."""
    return [numbers(v) if np.ndim(v) else number(v) for v in values]


def signal(values: Any, picks: int = 12) -> Json:
    """Return a long array as its size, norm, sum and a few of its samples."""
    array = np.asarray(values, dtype=np.float64)
    flat = array.ravel()
    chosen = np.linspace(0, max(flat.size - 1, 0), min(picks, flat.size)).round().astype(int)
    weights = np.cos(np.arange(flat.size) * 0.7)  # tells a permutation, too
    norm = float(np.linalg.norm(flat))
    return {
        "shape": list(array.shape),
        "sized": [number(norm), number(flat.sum()), number(weights @ flat)],
        "picks": numbers(flat[chosen]),
    }


def code(word: Any) -> Any:
    """Return a word of an answer as golden.json has it."""
    return None if word is None else CODES.get(str(word), str(word))


def _name(name: str) -> str:
    return NAMES.get(name, name)


def _named(values: Mapping[str, Any]) -> Json:
    return {_name(name): number(value) for name, value in values.items()}


def refused(run: Callable[[], Any]) -> Json:
    """Return what a call gives, or that it was refused."""
    try:
        return {"answer": run()}
    except FAILURES:
        return {"refused": True}


def ready() -> None:
    """Load the compiled simulation, or compile it, so that no case's time has it."""
    warm_up(wait=True)


# The command line


def command(*words: object) -> str:
    """Run a command in this process and return what it prints; a failure is an error."""
    out, err = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(err):
        ended = _exit_code([str(word) for word in words])
    if ended != 0:
        error = Refused if ended == _MISTAKE else RuntimeError
        raise error(f"jointid {' '.join(map(str, words))} ended with {ended}: {err.getvalue().strip()}")
    return out.getvalue()


def exit_code(*words: object) -> int:
    """Run a command in this process and return its exit code."""
    with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
        return _exit_code([str(word) for word in words])


def _exit_code(words: list[str]) -> int:
    try:
        main(words)
    except SystemExit as ended:
        return int(ended.code or 0)
    return 0


def _asked(folder: Path, *words: object) -> Json:
    """Return the JSON answer of a command."""
    return _asked_and_said(folder, *words)[0]


def _asked_and_said(folder: Path, *words: object) -> tuple[Json, str]:
    """Return the JSON answer of a command, and what it prints."""
    path = folder / "answer.json"
    path.unlink(missing_ok=True)
    said = command(*words, "--json", path)
    return json.loads(path.read_text(encoding="utf-8")), said


def answer(folder: Path, *words: object) -> Json:
    """Return the text of a command's answer, and a digest of its document."""
    found, said = _asked_and_said(folder, *words)
    return {"text": text(said), "document": digest(found)}


def digest(document: Json) -> Json:
    """Return the keys of a document at its top, a checksum of all keys, and its numbers on a scale of magnitudes."""
    kept = {key: value for key, value in document.items() if key not in _CHANGING}
    values = np.array(list(_flat(kept)))
    keys = "\n".join(sorted(set(_paths(kept))))
    magnitudes = np.sign(values) * np.log1p(np.abs(values) / 1e-12)
    return {"keys": sorted(kept), "paths": crc32(keys.encode()), "numbers": signal(magnitudes)}


_CHANGING = ("jointid", "provenance", "version", "versions", "record_file", "record_date")


def _paths(found: Any, above: str = "") -> Iterable[str]:
    """Return the path of every key, without the places in lists."""
    if isinstance(found, Mapping):
        for key, value in found.items():
            yield f"{above}/{key}"
            yield from _paths(value, f"{above}/{key}")
    elif isinstance(found, list | tuple):
        for value in found:
            yield from _paths(value, f"{above}/*")


_LEFT_OUT = re.compile(r"!\[.*|#+ .*|\*[^*]*\*")  # figures, headings and captions


def text(said: str) -> Json:
    """Return what an answer says first, its other texts, and of its tables the numbers; of Markdown the rows."""
    said = said.partition("\n## Settings and data\n")[0].replace("\u2212", "-")
    said = re.sub(r"^Written:?\s.*?(?:\n\s*\n|\Z)", "\n", said, flags=re.DOTALL | re.MULTILINE)
    texts: list[str] = []
    tables: list[list[Any]] = []
    for block in re.split(r"\n\s*\n", said.strip()):
        above, rule, below = block.partition("\n---")
        if block.startswith("|"):
            tables.append(block.splitlines()[2:])
        elif rule:
            texts += [" ".join(line.split()) for line in above.splitlines()[:-1]]
            tables.append(numbers(map(float, _NUMBER.findall(below))))
        elif not _LEFT_OUT.fullmatch(line := " ".join(block.split())):
            texts.append(line)
    return {"first": texts[0], "texts": texts[1:], "tables": tables}


def failure(*words: object) -> str:
    """Return what a command says that refuses, without the places of files."""
    try:
        command(*words, "--quiet")
    except Refused as error:
        said = str(error).partition(f"ended with {_MISTAKE}: ")[2]
        return " ".join(re.sub(r"\S*/(?=[\w.]+)", "", said).split())
    raise RuntimeError(f"jointid {' '.join(map(str, words))} did not refuse")


def demo(folder: Path) -> Json:
    """Run the demo into a folder and return its estimate, and what it recorded."""
    command("demo", folder, "--quiet")
    record = np.genfromtxt(folder / "record.csv", delimiter=",", names=True)
    return {
        "estimate": estimate(json.loads((folder / "estimate.json").read_text(encoding="utf-8"))),
        "record": {name: signal(record[name]) for name in record.dtype.names or ()},
        "files": sorted(path.name for path in folder.iterdir()),
    }


def twin_file(
    path: Path, *, loop: str = "L19", added_mass: bool = False, noise: str = "disturbance", seed: int = 1
) -> Path:
    """Write a run of the paper's twin and return where it is."""
    heavier = ["--added-mass"] if added_mass else []
    command("simulate", "--twin", loop, *heavier, "--noise", noise, "--seed", seed, "--out", path, "--quiet")
    return path


def identify(folder: Path, joint: Path, record: Path, **options: object) -> Json:
    """Identify by the command line, with its options."""
    return estimate(identify_answer(folder, joint, record, **options))


_CHOICES = ("method", "filtering", "friction")  # the options that are no keys of [method]


def identify_answer(folder: Path, joint: Path, record: Path, **options: object) -> Json:
    """Return the answer of `identify` as it is."""
    given: list[object] = []
    for name, value in options.items():
        given += [f"--{name}", value] if name in _CHOICES else ["--set", f"method.{name}={value}"]
    return _asked(folder, "identify", joint, "--record", record, *given, "--quiet")


def estimate_file(folder: Path, joint: Path, record: Path, name: str = "estimate.json") -> Path:
    """Identify, and return the file that the answer is in."""
    path = folder / name
    command("identify", joint, "--record", record, "--json", path, "--quiet")
    return path


def together(folder: Path, joint: Path) -> Json:
    """Identify from the records of a joint file together."""
    return _together(_asked(folder, "identify", joint, "--quiet"))


def long(folder: Path, joint: Path, record: Path, window: float) -> Json:
    """Identify a long record in windows."""
    return _long(_asked(folder, "identify", joint, "--record", record, "--window", window, "--quiet"))


def compare(folder: Path, joint: Path, record: Path) -> Json:
    """Identify by every method that runs."""
    answer = _asked(folder, "diagnose", "methods", joint, "--record", record, "--quiet")
    return {
        "methods": [
            {
                "estimate": None if one["estimate"] is None else estimate(one["estimate"]),
                "refused": bool(one["refusal"]),
            }
            for one in answer["methods"]
        ],
        "disagreements": len(answer["disagreements"]),
    }


def validate(folder: Path, joint: Path, record: Path, identified: Path) -> Json:
    """Compare an estimate with a record."""
    return _validation(_asked(folder, "validate", joint, "--record", record, "--estimate", identified, "--quiet"))


def advise(folder: Path, joint: Path, record: Path) -> Json:
    """Ask which sensors and motions would tell more."""
    answer = _asked(folder, "advise", joint, "--record", record, "--quiet")
    return {
        "noise": code(answer["noise"]),
        "std": {_name(name): number(p["std"]) for name, p in answer["parameters"].items()},
        "sensors": [None if one["std"] is None else _named(one["std"]) for one in answer["sensors"]],
        "tests": [None if one["std"] is None else _named(one["std"]) for one in answer["tests"]],
        "sentences": len(answer["sentences"]),
    }


def tune(folder: Path, joint: Path, record: Path, **options: object) -> Json:
    """Ask for margins, gains, feed-forward and detectable changes."""
    given = [word for name, value in options.items() for word in (f"--{name.replace('_', '-')}", value)]
    answer = _asked(folder, "tune", joint, "--record", record, *given, "--quiet")
    notch = answer["notch"]
    return {
        "asked": _named(answer["asked"]),
        "present": _margins(answer["present"]),
        "proposed": None if answer["proposed"] is None else _margins(answer["proposed"]),
        "gains": {g["key"]: [number(g["before"]), number(g["after"])] for g in answer["gains"]},
        "notch": None if notch is None else _only_numbers(notch),
        "feedforward": [_only_numbers(one) for one in answer["feedforward"]],
        "detectable": _only_numbers(answer["detectable"]),
        "notes": len(answer["notes"]),
    }


def learn(folder: Path, joint: Path, record: Path) -> Json:
    """Learn the controller; the law that is written is read back."""
    written = folder / "learned.toml"
    answer = _asked(folder, "learn-controller", joint, "--record", record, "--write", written, "--quiet")
    return {
        "law": {"kind": code(answer["law"]["name"]), "numbers": _named(answer["law"]["numbers"])},
        "numbers": [_only_numbers(one) for one in answer["numbers"]],
        "correlation": numbers(answer["correlation"]),
        "equivalent": len(answer["equivalent"]),
        "alternatives": [
            {
                "law": {"kind": code(one["law"]["name"]), "numbers": _named(one["law"]["numbers"])},
                "worse": number(one["worse"]),
                "apart": number(one["apart_percent"]),
                "alike": one["alike"],
            }
            for one in answer["alternatives"]
        ],
        "residual": [number(answer["residual"]["rms"]), number(answer["residual"]["percent"])],
        "noise": _only_numbers(answer["noise"]),
        "sentences": len(answer["sentences"]),
        "written": sorted(numbers(_flat(tomllib.loads(written.read_text(encoding="utf-8"))["controller"]))),
    }


def simulate(folder: Path, joint: Path, record: Path, identified: Path | None = None, suffix: str = ".csv") -> Json:
    """Simulate the loop of a joint file and read back what is written."""
    out = folder / f"simulated{suffix}"
    given = [] if identified is None else ["--estimate", identified]
    answer = _asked(folder, "simulate", joint, "--record", record, *given, "--out", out, "--quiet")
    return {
        "parameters": {_name(name): number(p["value"]) for name, p in answer["parameters"].items()},
        "outcome": code(answer["outcome"]),
        "numbers": [
            number(answer[key]) for key in ("samples", "sample_time", "events", "at_limit_percent", "peak_torque")
        ],
        "record": recorded(load_joint(joint).record(out)),
    }


def inspect(folder: Path, path: Path) -> Json:
    """List what is in a file."""
    return _inspection(_asked(folder, "data", "inspect", path))


def convert(source: Path, target: Path) -> None:
    """Write a file in another format."""
    command("data", "convert", source, target)


def export(folder: Path, joint: Path, identified: Path, *words: object) -> Any:
    """Write an estimate for another tool and return the numbers in the text."""
    out, *options = words
    path = folder / str(out)
    command("export", joint, "--estimate", identified, "--out", path, *options)
    return _within(path)


def compare_reports(folder: Path, before: Path, after: Path) -> Json:
    """Ask what changed between two estimates."""
    answer = _asked(folder, "compare", before, after)
    return {
        "same_record": answer["same_record"],
        "level": number(answer["level"]),
        "quantities": {
            name: {key: number(row[key]) for key in ("a", "b", "difference", "std", "p_value", "changed")}
            for name, row in answer["quantities"].items()
        },
        "sentences": len(answer["sentences"]),
    }


def report(folder: Path, joint: Path, record: Path, *, profiles: bool = True) -> Json:
    """Write the page of a report and return the numbers that it carries along."""
    page = folder / "report.html"
    command("report", joint, "--record", record, "--html", page, "--no-profiles", "--no-tuning", "--quiet")
    text = page.read_text(encoding="utf-8")
    found = re.search(r'<script[^>]*id="jointid-answer"[^>]*>(.*?)</script>', text, re.DOTALL)
    assert found is not None
    answer = json.loads(found.group(1))
    if profiles:  # of every parameter: a report leaves out those whose criterion is a parabola
        file = load_joint(joint)
        logged = file.record(record)
        made = file.identify(logged, checks=False)
        free = [p.name for p in made.params.rows if p.of_joint and p.free]
        told = ji.Report.of(made, logged, profiles=free)
        answer |= {name: json.loads(told.answer())[name] for name in ("profiles", "absent")}
    return {
        "estimate": estimate(answer["estimate"]),
        "validation": None if answer["validation"] is None else _validation(answer["validation"]),
        "checks": [_validation(check) for check in answer["checks"]],
        "loop": None if answer["diagnosis"] is None else _loop_check(answer["diagnosis"]),
        "profiles": [_profile_answer(one) for one in answer["profiles"]],
        "frequencies": _named(answer["frequencies"]),
        "revealing": None if answer["revealing"] is None else _revealing(answer["revealing"]),
        "absent": sorted(answer["absent"]),
    }


def report_text(folder: Path, file: Path, *words: object) -> Json:
    """Write a report as Markdown, and return its text up to settings and data."""
    place = folder / "markdown"
    place.mkdir(exist_ok=True)
    found = answer(folder, "report", file, *words, "--markdown", place, "--quiet")
    return found | {"page": text((place / "report.md").read_text(encoding="utf-8"))}


def page_answer(folder: Path, joint: Path, record: Path) -> Json:
    """Identify as the page does, and return what it shows."""
    (folder / "joint.toml").write_bytes(joint.read_bytes())
    (folder / record.name).write_bytes(record.read_bytes())
    (folder / "work.json").write_text(json.dumps({"file": record.name, "learn": False}), encoding="utf-8")
    with patch.multiple(
        worker, _write_report=lambda *_: None, _print_progress=lambda _: None
    ):  # the report is a case of its own
        if worker.main("identify", folder):
            raise Refused((folder / "fault.json").read_text(encoding="utf-8"))
    found = json.loads((folder / "answer.json").read_text(encoding="utf-8"))
    said = (folder / "answer.txt").read_text(encoding="utf-8")
    return {"text": text(said), "document": digest(found), "estimate": estimate(found)}


# Robots


def robot_files(folder: Path, model: str, tables: Json, references: Mapping[str, Any]) -> Path:
    """Write a robot file with its model and references, (samples, n), of 1 ms; return where it is."""
    (folder / "robot.xml").write_text(model, encoding="utf-8")
    channels = {"torque": "tau{axis}", "reference": "r{axis}", "motor_position": "q{axis}"}
    record = {"sample_time": 1e-3, "channels": {name: {"column": column} for name, column in channels.items()}}
    path = folder / "robot.toml"
    write_toml(path, {"robot": {"model": "robot.xml"}, "record": record} | tables)
    for name, columns in references.items():
        header = ",".join(f"r{k + 1}" for k in range(columns.shape[1]))
        np.savetxt(folder / name, columns, fmt="%.12g", delimiter=",", header=header, comments="")
    return path


def robot_run(robot: Path, references: str, name: str, *, noise: float, seed: int) -> Json:
    """Simulate a robot into a record of that name, and add noise to its torques, a share of each one's deviation."""
    path = robot.parent / name
    words = "simulate", robot, "--record", robot.parent / references, "--out", path, "--quiet"
    found = answer(robot.parent, *words)
    header, *_ = path.read_text(encoding="utf-8").splitlines()
    table = np.loadtxt(path, delimiter=",", skiprows=1)
    random = np.random.default_rng(seed)
    for k, column in enumerate(header.split(",")):
        found[column] = signal(table[:, k])
        if column.startswith("tau"):
            table[:, k] += noise * np.std(table[:, k]) * random.normal(size=len(table))
    np.savetxt(path, table, fmt="%.12g", delimiter=",", header=header, comments="")
    return found


def _robot_words(robot: Path, settings: Mapping[str, object]) -> list[object]:
    return [robot, *(word for key, value in settings.items() for word in ("--set", f"{key}={value}")), "--quiet"]


def identify_robot(robot: Path, record: str | Path, *, folder: Path | None = None, **method: object) -> Json:
    """Identify a robot by the command line: its parameters, what is left of each joint's torque, and the text."""
    settings = {f"method.{name}": value for name, value in method.items()}
    words = [*_robot_words(robot, settings), "--details", "--record", robot.parent / record]
    found, said = _asked_and_said(folder or robot.parent, "identify", *words)
    return _robot(found) | {"text": text(said), "document": digest(found)}


def _robot(answer: Json) -> Json:
    rows = {
        _name_in_golden(name, row, answer["method"]): {
            "value": number(row["value"]), "std": number(row["std"]), "unit": row["unit"],
        }
        for name, row in answer["parameters"].items()
    }  # fmt: skip
    left = {key: numbers(answer["robot"][key]) for key in ("left", "nominal_left")}
    return {"parameters": rows, "converged": answer["converged"], **left}


def _name_in_golden(name: str, row: Mapping[str, Any], method: str) -> str:
    """Return the name that a parameter of a robot had when the numbers were frozen."""
    if method == "idim":
        return str(row["symbol"])
    if name != row["symbol"]:
        return name
    word, joint = name[:-1], name[-1]
    rotor = f"Ia{joint}" in row["formula"].split(" ")
    return f"joint{joint}.rotor_inertia" if rotor else f"link{joint}.{word}"


def of_robot(verb: str, robot: Path, *words: object, **method: object) -> Json:
    """Return the answer of another command with a robot file: text, document, and all numbers and truths of it."""
    settings = {f"method.{name}": value for name, value in method.items()}
    found, said = _asked_and_said(robot.parent, verb, *_robot_words(robot, settings), *words)
    kept = {key: value for key, value in found.items() if key not in _CHANGING}
    return {"text": text(said), "document": digest(found), "numbers": _only_numbers(kept)}


def export_robot(robot: Path, record: str, out: str, **method: object) -> Json:
    """Write bodies that fit a robot's estimate, and return the numbers in the file and what is said of them."""
    settings = {f"method.{name}": value for name, value in method.items()} | {"record.file": json.dumps(record)}
    path, (*words, _) = robot.parent / out, _robot_words(robot, settings)
    said = command("export", *words, "--out", path)
    return {"said": [line for line in said.splitlines() if not line.startswith("Written")], "file": _within(path)}


def report_robot(robot: Path, record: str, held_out: str, **method: object) -> Json:
    """Report a robot, held against another record, and return the text of its page."""
    settings = {f"method.{name}": value for name, value in method.items()}
    words = *_robot_words(robot, settings)[1:-1], "--record", robot.parent / record
    return report_text(robot.parent, robot, *words, "--held-out", robot.parent / held_out)


# Campaigns


def campaign(folder: Path, name: str, tables: Json) -> Json:
    """Run a campaign in this process, and return its rows and its report."""
    path, table = folder / f"{name}.toml", folder / f"{name}.csv"
    write_toml(path, tables)
    rows = tuple(run_case(one) for one in load_campaign(path).cases())
    export_rows(rows, table)
    report = CampaignReport(Results(name, len(rows), rows, ())).to_document(details=True)
    with table.open(encoding="utf-8", newline="") as file:
        return {"rows": [_campaign_row(row) for row in csv.DictReader(file)], "report": text(report.markdown())}


def _campaign_row(row: Mapping[str, str]) -> Json:
    words = ("joint", "day", "kind", "seed", "outcome", "sentence", "trust", "converged")
    values = {
        _name(key.partition(" ")[0]) + (key.partition(" ")[2] and f" {key.partition(' ')[2]}"): number(float(value))
        for key, value in row.items()
        if key.endswith("]") and value
    }
    return {word: code(row[word]) for word in words} | {"values": values, "simulations": row["simulations"]}


# Joint files


def write_toml(path: Path, tables: Json) -> None:
    """Write a file of tables."""
    path.write_text(tomli_w.dumps(tables), encoding="utf-8")


def joint_file(folder: Path, example: str, *variants: str, name: str = "joint.toml") -> Path:
    """Write a joint file that comes with the package, changed, and return where it is."""
    made = tomllib.loads(EXAMPLES[example].read_text(encoding="utf-8"))
    for variant in variants:
        _change(made, VARIANTS[variant])
    write_toml(folder / name, made)
    return folder / name


def _change(table: Json, changes: Mapping[str, Any]) -> None:
    for key, value in changes.items():
        if value is None:
            table.pop(key, None)
        elif isinstance(value, dict):
            _change(table.setdefault(key, {}), value)
        else:
            table[key] = value


# Answers of the command line


def estimate(answer: Json) -> Json:
    """Return the numbers of an estimate as it is written to JSON."""
    record, other = answer["record"], answer["other_side"]
    return {
        "method": code(answer["method"]),
        "model": code(answer["model"]),
        "kind": code(answer["kind"]),
        "friction": code(answer["friction"]),
        "gravity": answer["gravity"],
        "transmission": _transmission(answer["transmission"]),
        "record": {
            "samples": record["samples"],
            "sample_time": number(record["sample_time"]),
            "unit": record["torque_unit"],
            "fingerprint": len(record["torque_sha256"]) == 64,
            "resampled": record["resampled"] is not None,
        },
        "channels": sorted(map(code, answer["channels"])),
        "parameters": _parameters(answer["parameters"]),
        "other_side": None
        if other is None
        else {
            "parameters": _parameters(other["parameters"]),
            "combinations": _combinations(other["combinations"]),
            "stiffness_bounds": _bounds(other["stiffness_bounds"]),
        },
        "raw_error_percent": number(answer["relative_error_percent"]),
        "filtered_error_percent": number(answer["filtered_error_percent"]),
        "compared": code(answer["compared"]),
        "borders": answer["samples_left_out"],
        "rows": answer["rows"],
        "condition": None if answer["condition_numbers"] is None else _named(answer["condition_numbers"]),
        "filtering": _filtering(answer["filtering"]),
        "delay": number(answer["delay"]),
        "law_fingerprint": answer["controller_sha256"] is not None,
        "iterations": answer["iterations"],
        "simulations": answer["simulations"],
        "converged": answer["converged"],
        "trace": _trace(answer["trace"]),
        "tests": [_only_numbers(test) for test in answer["tests"]],
        "effects": [_only_numbers(effect) for effect in answer["effects"]],
        "warnings": len(answer["warnings"]),
        "verdicts": {
            code(v["subject"]): v["good"]
            for v in answer["verdicts"]
            if not (v["subject"] == "loop" and v["reasons"][0]["code"] == "not_tested")
        },
        "combinations": _combinations(answer["combinations"]),
        "residuals": _residuals(answer["residuals"]),
        "stiffness_bounds": _bounds(answer["stiffness_bounds"]),
    }


def _trace(answers: Sequence[Json]) -> Json:
    """Return the ends of a trace, and all of its residual norms."""
    return {
        "lines": [
            {
                "values": _named(line["values"]),
                "residual_norm": number(line["residual_norm"]),
                "simulations": line["simulations"],
                "gain_scale": number(line["gain_scale"]),
            }
            for line in (answers if len(answers) <= _FEW else [*answers[:2], *answers[-2:]])
        ],
        "residual_norms": signal([line["residual_norm"] for line in answers]),
    }


_FEW = 6  # lines of a trace that are kept whole


def _parameters(answers: Mapping[str, Json]) -> Json:
    keys = ("value", "std", "free", "identifiable", "lower_bound")
    return {_name(name): {key: number(p[key]) for key in keys} | {"unit": p["unit"]} for name, p in answers.items()}


def _transmission(answer: Json | None) -> Json | None:
    if answer is None:
        return None
    return {
        "motor_per_load": number(answer["motor_per_load"]),
        "lead": number(answer["lead"]),
        "kinds": [code(answer["motor_kind"]), code(answer["load_kind"])],
        "side": code(answer["side"]),
    }


def _filtering(answer: Json) -> Json:
    return {
        "position_cutoff": number(answer["position_cutoff"]),
        "cutoff": number(answer["cutoff"]),
        "decimation": answer["decimation"],
        "borders": answer["borders"],
        "timing": code(answer["timing"]),
        "aliasing": code(answer["aliasing"]),
    }


def _combinations(answers: Sequence[Json] | None) -> list[Json] | None:
    if answers is None:
        return None
    return [
        {
            "weights": _named(one["weights"]),
            "value": number(one["value"]),
            "std": number(one["std"]),
            "unit": one["unit"],
            "known": code(one["known"]),
        }
        for one in answers
    ]


def _residuals(answer: Json | None) -> Json | None:
    if answer is None:
        return None
    repeats = answer["repeatable"]
    return {
        "relative_percent": number(answer["relative_percent"]),
        "mean_removed_percent": number(answer["mean_removed_percent"]),
        "rms": number(answer["rms"]),
        "mean": number(answer["mean"]),
        "bands": [
            [number(band[key]) for key in ("low_hz", "high_hz", "error_percent", "share_percent")]
            for band in answer["bands"]
        ],
        "against_rigid_percent": number(answer["against_rigid_percent"]),
        "whiteness_p": number(answer["whiteness_p"]),
        "repeatable": None if repeats is None else _repeatable(repeats["rms"], repeats["share_percent"], repeats["p"]),
    }


def _repeatable(rms: Any, percent: Any, p: Any) -> Json:
    return {"rms": number(rms), "share_percent": number(percent), "p": number(p)}


def _bounds(answers: Sequence[Json]) -> list[Json]:
    return [
        {"share": number(b["load_share"]), "stiffness": number(b["stiffness"]), "hz": number(b["free_free_hz"])}
        for b in answers
    ]


def _together(answer: Json) -> Json:
    agreement = answer["agreement"]
    return {
        "model": code(answer["model"]),
        "parameters": _parameters(answer["parameters"]),
        "records": [
            {
                "samples": one["samples"],
                "fingerprint": len(one["torque_sha256"]) == 64,
                "added_inertia": number(one["added_inertia"]),
                "parameters": _parameters(one["parameters"]),
                "alone": _parameters(one["alone"]),
                "values": _named(one["values"]),
                "initial": None if one["initial"] is None else _named(one["initial"]),
                "level": number(one["residual_level"]),
                "repeatable": _repeatable(
                    one["repeatable"]["rms"], 100 * one["repeatable"]["share"], one["repeatable"]["p_value"]
                ),
                "filtering": _filtering(one["filtering"]),
                "rows": one["rows"],
                "raw_error_percent": number(one["relative_error_percent"]),
                "filtered_error_percent": number(one["filtered_error_percent"]),
                "alone_error_percent": number(one["filtered_error_alone_percent"]),
            }
            for one in answer["records"]
        ],
        "agreement": {
            "differs": agreement["differs"],
            "chi_square": number(agreement["chi_square"]),
            "degrees": agreement["degrees_of_freedom"],
            "p_value": number(agreement["p_value"]),
            "parameters": {_name(name): _only_numbers(p) for name, p in agreement["parameters"].items()},
        },
        "free": [_name(name) for name in answer["free"]],
        "correlation": numbers(answer["correlation"]),
        "simulations": answer["simulations"],
        "converged": answer["converged"],
        "weighting": code(answer["weighting"]),
        "warnings": len(answer["warnings"]),
    }


def _long(answer: Json) -> Json:
    log = answer["log"]
    drift, repeats = log["drift"], log["repeatable"]
    return {
        "model": code(answer["model"]),
        "parameters": _parameters(answer["parameters"]),
        "combinations": _combinations(answer["combinations"]),
        "correlation": numbers(answer["correlation"]),
        "repeatable": _repeatable(repeats["rms"], repeats["share_percent"], repeats["p"]),
        "drift": {
            "differs": drift["differs"],
            "p_value": number(drift["p_value"]),
            "parameters": {_name(name): _only_numbers(p) for name, p in drift["parameters"].items()},
            "stretches": [
                {
                    "ends": [number(s["begin"]), number(s["end"]), s["windows"]],
                    "values": _named(s["values"]),
                    "std": _named(s["std"]),
                    "filtered_error_percent": number(s["filtered_error_percent"]),
                }
                for s in drift["stretches"]
            ],
        },
        "windows": {key: number(log[key]) for key in ("window", "settling", "windows", "windows_without_motion")},
        "duration": number(log["duration"]),
        "rows": answer["rows"],
        "filtered_error_percent": number(answer["filtered_error_percent"]),
        "filtering": _filtering(answer["filtering"]),
        "at_limit": number(log["at_limit"]),
        "law_fingerprint": answer["controller_sha256"] is not None,
        "passes": log["passes"],
        "simulations": answer["simulations"],
        "converged": answer["converged"],
        "warnings": len(answer["warnings"]),
    }


def _validation(answer: Json) -> Json:
    return {
        "test": code(answer["test"]),
        "method": code(answer["method"]),
        "channels": sorted(map(code, answer["channels"])),
        "raw_error_percent": number(answer["relative_error_percent"]),
        "filtered_error_percent": number(answer["filtered_error_percent"]),
        "tracking_error_percent": number(answer["tracking_error_percent"]),
        "borders": answer["samples_left_out"],
        "autocorrelation": signal(answer["axes"][0]["autocorrelation"]),
        "white_band": number(answer["axes"][0]["white_band"]),
        "outside_band_percent": number(answer["axes"][0]["outside_band_percent"]),
        "initial": None if answer["initial"] is None else _named(answer["initial"]),
        "simulations": answer["simulations"],
        "warnings": len(answer["warnings"]),
    }


def _loop_check(answer: Json) -> Json:
    def suspect(s: Json) -> Json:
        return {
            "name": code(s["name"]),
            "alike": len(s["alike"]),
            "value": number(s["more_than_declared"]),
            "std": number(s["std"]),
            "declared": number(s["declared"]),
            "statistic": number(s["statistic"]),
            "p_value": number(s["p_value"]),
        }

    [axis] = answer["axes"]
    return {
        "as_declared": answer["as_declared"],
        "level": number(axis["level"]),
        "findings": [
            {
                "suspect": suspect(finding["suspect"]),
                "value": number(finding["value"]),
                "rivals": [code(rival) for rival in finding["rivals"]],
                "changes": {_name(name): _named(change) for name, change in finding["changes"].items()},
            }
            for finding in axis["findings"]
        ],
        "suspects": [suspect(s) for s in axis["suspects"]],
        "sentences": len(answer["reasons"]),
    }


def _revealing(answer: Json) -> Json:
    def told(lines: Sequence[Json]) -> list[Any]:
        keys = ("load_share", "excluded_below_hz", "relative_std", "told_below_hz")
        return [[number(line[key]) for key in keys] for line in lines]

    pulses, encoder = answer["pulses"], answer["load_encoder"]
    return {
        "pulses": {"height": number(pulses["height"]), "width": number(pulses["width"]), "told": told(pulses["told"])},
        "load_encoder": {"step": number(encoder["step"]), "told": told(encoder["told"])},
    }


def _profile_answer(one: Json) -> Json:
    return {
        "name": _name(one["name"]),
        "estimate": number(one["estimate"]),
        "level": number(one["level"]),
        "interval": numbers(one["interval"]),
        "reached": numbers(one["reached"]),
        "values": numbers(one["values"]),
        "rise": numbers(one["rise"]),
        "threshold": number(one["threshold"]),
        "minimum": one["estimate_was_minimum"],
    }


def _margins(answer: Json) -> Json:
    response = answer["response"]
    return {
        "estimate": _named(answer["estimate"]),
        "worst": _named(answer["worst"]),
        "crossover": number(answer["crossover_hz"]),
        "response": {key: signal(values) for key, values in response.items()},
    }


def _inspection(answer: Json) -> Json:
    return {
        "format": code(answer["format"]),
        "channels": [
            {key: number(channel[key]) for key in ("rows", "minimum", "maximum", "missing", "sample_time", "jitter")}
            | {key: channel[key] for key in ("name", "unit", "time")}
            for channel in answer["channels"]
        ],
        "scalars": _named(answer["scalars"]),
        "not_read": len(answer["not_read"]),
    }


def _only_numbers(answer: Any) -> Any:
    """Return an answer without its words: text that is neither a number nor a truth is left out."""
    if isinstance(answer, Mapping):
        kept = {key: _only_numbers(value) for key, value in answer.items() if not isinstance(value, str)}
        return {_name(key): value for key, value in kept.items()}
    if isinstance(answer, list | tuple):
        return [_only_numbers(value) for value in answer if not isinstance(value, str)]
    return number(answer)


def _flat(answer: Any) -> Iterable[float]:
    """Return every number in an answer."""
    if isinstance(answer, Mapping):
        for key in sorted(answer):
            yield from _flat(answer[key])
    elif isinstance(answer, list | tuple):
        for value in answer:
            yield from _flat(value)
    elif isinstance(answer, int | float) and not isinstance(answer, bool):
        yield float(answer)


# Texts in other tools' languages

_NUMBER = re.compile(r"(?<![\w.])[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?(?![\w])")
_UNTOLD = {
    ".mo": r'//[^\n]*|/\*.*?\*/|"(?:[^"\\]|\\.)*"',  # comments and texts
    ".m": r"%[^\n]*|'[^'\n]*'|\"[^\"\n]*\"",
}


def _within(path: Path) -> Any:
    text = path.read_text(encoding="utf-8")
    if path.suffix == ".json":
        return _only_numbers({k: v for k, v in json.loads(text).items() if k != "provenance"})
    if path.suffix == ".toml":
        return sorted(_flat(tomllib.loads(text)))
    if path.suffix in (".xml", ".urdf"):
        return [
            [element.tag, key, numbers(map(float, value.split()))]
            for element in ET.fromstring(text).iter()
            for key, value in sorted(element.attrib.items())
            if all(_NUMBER.fullmatch(word) for word in value.split()) and value
        ]
    bare = re.sub(_UNTOLD[path.suffix], " ", text, flags=re.DOTALL)
    return [number(float(found)) for found in _NUMBER.findall(bare)]


# The same from Python, which holds more than the answers do


def load(joint: Path, record: Path, **overridden: Any) -> tuple[Any, Any]:
    """Return a joint file, overridden, and its record."""
    file = load_joint(joint, **overridden)
    return file, file.record(record)


def identify_file(joint: Path, record: Path, **overridden: Any) -> Any:
    """Return what a joint file and a record make, as an object, and the record."""
    file, logged = load(joint, record, **overridden)
    return file.identify(logged), logged


def whole(found: Any) -> Json:
    """Return an estimate with its covariance, its predicted torque and all that is known of combinations."""
    answer = estimate(ji.to_dict(found))
    answer["verdicts"].pop("loop", None)  # see `check_loop`
    free = [p for p in found.params.rows if p.free]
    known, fitted = found.checks.known, found.fit
    correlation = np.asarray(found.params.correlation)
    std = np.array([p.stderr if p.stderr is not None else np.nan for p in free])[: len(correlation)]
    answer |= {
        "free": [_name(p.name) for p in free],
        "correlation": numbers(correlation),
        "covariance": numbers(correlation * np.outer(std, std)) if correlation.size else [],
        "measured": signal(fitted.measured),
        "predicted": signal(fitted.predicted),
        "error": signal(fitted.predicted - fitted.measured),
        "raw_error": number(fitted.relative_error),
        "initial": None
        if fitted.initial is None
        else numbers([fitted.initial.position, fitted.initial.velocity, fitted.initial.torque]),
    }
    if known is not None:
        answer["known"] = {
            "parameters": [_known(one) for one in known.parameters],
            "physical": [_known(one) for one in known.physical],
            "directions": [_known(one) for one in known.directions],
            "condition": number(known.condition),
            "undetermined": [_name(m.values["parameter"]) for m in known.limitations if m.code == "not_significant"],
            "sentences": len(known.limitations),
        }
    return answer


def _known(one: Any) -> Json:
    return {
        "weights": {_name(name): number(weight) for name, weight in one.combination.weights.items()},
        "value": number(one.value),
        "std": number(one.std),
        "relative": number(one.relative),
        "interval": numbers(one.interval),
        "known": code(one.verdict),
    }


def total(found: Any, names: Sequence[str]) -> list[Any]:
    """Return a sum of parameters and its deviation."""
    return numbers(found.params.total(tuple(names)))


def check_loop(found: Any, record: Any) -> Json:
    """Return the check of loop and log, and the verdict on it."""
    verdicts = {code(v.subject): v.good for v in found.checks.verdicts}
    return _loop_check(ji.to_dict(ji.diagnose(found, record))) | {"verdicts": verdicts}


def intervals(
    found: Any, record: Any, quantities: Sequence[str], *, draws: int = 0, seed: int = 0, refit: bool = False
) -> Json:
    """Return profiles of quantities, and bootstraps where draws are asked for."""
    given = ji.intervals(
        found, record, quantities, bootstrap=draws > 0, refit=refit,
        bootstrapping=Bootstrapping(draws=draws, seed=seed) if draws else None,
    )  # fmt: skip
    return {
        "profiles": [
            {
                "name": _name(one.name),
                "estimate": number(one.estimate),
                "level": number(one.level),
                "values": numbers(one.points),
                "rise": numbers(one.rise),
                "parameters": signal(one.parameters),
                "threshold": number(one.threshold),
                "interval": numbers(one.interval),
                "reached": numbers(one.reached),
                "improved": one.improved,
                "evaluations": one.evaluations,
            }
            for one in given.profiles
        ],
        "over_time": None if given.over_time is None else _bootstrap(given.over_time),
        "over_place": None if given.over_place is None else _bootstrap(given.over_place),
    }


def _bootstrap(drawn: Any) -> Json:
    return {
        "parameters": {
            _name(p.name): {
                "value": number(value),
                "std": number(std),
                "interval": numbers(interval),
            }
            for p, value, std, interval in zip(
                drawn.parameters, drawn.estimate, drawn.std, drawn.intervals, strict=True
            )
        },
        "correlation": numbers(drawn.correlation),
        "level": number(drawn.level),
        "blocks": number(drawn.blocks),
        "draws": len(drawn.draws),
    }


# Loops of one's own

KEYWORDS: Mapping[str, str] = {}
"""Keywords of the cases to those of today, where one was renamed since."""

_LAWS = {
    "cascade": ji.controller.Cascade,
    "pd": ji.controller.PD,
    "pid": ji.controller.PID,
    "state_space": ji.controller.StateSpaceController,
}
_FILTERS = {
    "digital": ji.controller.DigitalFilter,
    "moving_average": ji.controller.MovingAverage,
    "first_order": ji.controller.FirstOrder,
    "second_order": ji.controller.SecondOrder,
    "notch": ji.controller.Notch,
}


def _keywords(given: Mapping[str, Any]) -> Json:
    return {KEYWORDS.get(key, key): value for key, value in given.items()}


def law(kind: str, **given: Any) -> Any:
    """Return a controller: "cascade", "pd", "pid" or "state_space"."""
    return _LAWS[kind](**_keywords(given))


def digital_filter(kind: str, **given: Any) -> Any:
    """Return a filter of a controller."""
    return _FILTERS[kind](**_keywords(given))


def joint(
    model: str,
    kind: Any = "prismatic",
    *,
    asymmetric: bool = False,
    torque_unit: str | None = None,
    gravity: Any = None,
    counterbalance: Mapping[str, float] | None = None,
    angle: float = 1.0,
    gear: Mapping[str, Any] | None = None,
) -> Any:
    """Return a joint: "rigid" or "flexible"."""
    made = ji.RigidJoint if model == "rigid" else ji.FlexibleJoint
    carried = None
    if gravity is not None:
        carried = ji.Gravity(gravity, ji.spring.Counterbalance(**_keywords(counterbalance or {})), angle=angle)
    return made(
        kind,
        friction=ji.friction.AsymmetricFriction() if asymmetric else ji.friction.SymmetricFriction(),
        torque_unit=torque_unit,
        transmission=None if gear is None else ji.Transmission(**_keywords(gear)),
        gravity=carried,
    )


def loop(of: Any, controller: Any) -> Any:
    """Return a joint under a controller."""
    return ji.ClosedLoop(of, controller)


def trapezoids(*given: Any, **also: Any) -> Any:
    """Return a reference that goes there and back."""
    return ji.excitation.trapezoids(*given, **_keywords(also))


def pulses(*given: Any, **also: Any) -> Any:
    """Return short pulses at irregular times."""
    return ji.excitation.pulses(*given, **_keywords(also))


def _valued(values: Mapping[str, float]) -> dict[str, float]:
    today = {then: now for now, then in NAMES.items()}
    return {today.get(name, name): value for name, value in values.items()}


def simulated(driven: Any, reference: Any, values: Mapping[str, float], **given: Any) -> Any:
    """Return the record of a loop that is driven along a reference."""
    return ji.simulated_record(driven, reference, _valued(values), **_keywords(given))


def twin(**given: Any) -> tuple[Any, Any, dict[str, float]]:
    """Return record, loop and truth of a run of the paper's twin."""
    made = ji.twin(**_keywords(given))
    return made.record, made.loop, dict(made.truth)


def servo(seed: int) -> tuple[Any, Any, dict[str, float]]:
    """Return record, loop and truth of the twin of a servo drive."""
    made = servo_twin(seed=seed)
    return made.record, made.loop, dict(made.truth)


def torque_only(record: Any) -> Any:
    """Return a record without its positions."""
    return record.without("motor_position", "load_position")


def recorded(record: Any) -> Json:
    """Return what is in a record."""
    return {
        _name(name): {
            "unit": channel.unit,
            "sample_time": number(channel.sample_time),
            "timing": code(channel.timing.value),
            "values": signal(channel.values),
        }
        for name, channel in record.items()
    }


def flexible_didim(**given: Any) -> Any:
    """Return settings of DIDIM for a flexible joint."""
    return ji.DIDIM(**_keywords(given))


def idim(estimator: Any = "ols", *, harmonics: int = 0, period: float | None = None, drift: Any = None) -> Any:
    """Return settings of IDIM."""
    effects: list[Any] = []
    if harmonics:
        effects.append(PositionHarmonics(period=period, harmonics=harmonics))
    if drift is not None:
        effects.append(Drift(drift))
    return ji.IDIM(estimator, tuple(effects))


def drive_side(of: Any) -> Any:
    """Return the model of a joint whose motor's motion is prescribed."""
    return ji.DriveSide(of)


def fit(record: Any, model: Any, method: Any = None, *, filtering: Mapping[str, Any] | None = None) -> Any:
    """Identify, and return the estimate as an object."""
    given = None if filtering is None else ji.Filtering(**_keywords(filtering))
    return ji.identify(record, model, method, filtering=given, checks=False)


def fit_together(records: Sequence[Any], loops: Any, **given: Any) -> Json:
    """Identify from several records together."""
    several = _keywords(given)
    rest = {name: several.pop(name) for name in ("method", "filtering", "parameters") if name in several}
    found = ji.identify(records, loops, several=ji.SeveralRecords(**several), **rest)
    return _together(ji.to_dict(found))


_WINDOWING = {"window": "length", "settling": "settling"}


def fit_long(record: Any, driven: Any, **given: Any) -> Json:
    """Identify from one record in windows."""
    rest = _keywords(given)
    windows = ji.Windowing(**{new: rest.pop(old) for old, new in _WINDOWING.items() if old in rest})
    return _long(ji.to_dict(ji.identify(record, driven, windows=windows, **rest)))


def learned(record: Any, **given: Any) -> Json:
    """Learn the law of a record."""
    found = ji.learn_controller(record, **_keywords(given))
    answer = ji.to_dict(found)
    return {
        "law": {"kind": code(answer["law"]["name"]), "numbers": _named(answer["law"]["numbers"])},
        "numbers": [_only_numbers(one) for one in answer["numbers"]],
        "correlation": numbers(answer["correlation"]),
        "residual": numbers([found.rms, found.share]),
        "alternatives": len(answer["alternatives"]),
        "signal": signal(found.residual),
    }


def run(driven: Any, record: Any, values: Mapping[str, float], initial: Sequence[float | None] | None = None) -> Json:
    """Simulate one candidate and return every signal of it."""
    made = ji.simulate(driven, prepare(driven, record), _valued(values), None if initial is None else Initial(*initial))
    return {
        "outcome": code(made.outcome.name.lower()),
        "finished": number(made.finished),
        "events": made.events,
        "at_limit": number(made.at_limit),
        "torque": signal(made.torque),
        "motor_position": signal(made.motor_position),
        "motor_velocity": signal(made.motor_velocity),
        "motor_acceleration": signal(made.motor.acceleration),
        "load_position": None if made.load_position is None else signal(made.load_position),
        "load_velocity": None if made.load_velocity is None else signal(made.load_velocity),
    }


def run_many(driven: Any, record: Any, candidates: Sequence[Mapping[str, float]], workers: int | None) -> list[Json]:
    """Simulate many candidates for their torque."""
    made = simulate_many(driven, prepare(driven, record), [_valued(v) for v in candidates], workers=workers)
    return [
        {
            "outcome": code(one.outcome.name.lower()),
            "numbers": numbers([one.finished, one.events, one.at_limit]),
            "torque": signal(one.torque),
        }
        for one in made
    ]


def slopes(driven: Any, record: Any, values: Mapping[str, float], names: Sequence[str], **given: Any) -> Json:
    """Simulate one candidate with its derivatives."""
    today = {then: now for now, then in NAMES.items()}
    asked = [today.get(name, name) for name in names]
    made = simulate_sensitivities(driven, prepare(driven, record), _valued(values), asked, **_keywords(given))
    return {
        "events": made.response.events,
        "torque": {name: signal(made.torque[:, i]) for i, name in enumerate(names)},
        "motor_position": signal(made.motor_position),
        "load_position": signal(made.load_position),
    }


def response(of: Any, values: Mapping[str, float], hertz: Any, output: Any) -> Json:
    """Return the frequency response of a joint."""
    made = frequency_response(of, _valued(values), np.asarray(hertz), output)
    return {"real": numbers(made.real), "imaginary": numbers(made.imag)}


def modes(values: Mapping[str, float]) -> Json:
    """Return the three frequencies of a flexible joint, and its rigid sums."""
    return {
        "hertz": _named(ji.FlexibleJoint.frequencies(_valued(values))),
        "sums": _named(ji.FlexibleJoint.rigid_sums(_valued(values))),
    }


def matrices(found: Any, period: float | None = None, side: Any = None) -> Json:
    """Return the state space of an estimate, sampled where a period is given."""
    made = ji.state_space(found, side=side)
    if period is not None:
        made = made.discretise(period)
    return {
        **{key: numbers(getattr(made, key)) for key in "ABCD"},
        "period": number(made.period),
        "delay": number(made.delay),
        "states": len(made.states),
        "units": dict(made.units),
    }


def read_export(identified: Path, joint_path: Path) -> Any:
    """Return an answer read back for export."""
    return read_joint_model(identified, load_joint(joint_path).joint)


def dossier(found: Any, record: Any) -> Json:
    """Return what a report is made of and its page does not carry: motion, spectra and responses."""
    made = collect(found, record, profiles=())
    spectra, answering = made.spectra, made.response
    return {
        "channels": [[number(one.sample_time), len(one), one.unit] for one in made.channels.values()],
        "motion": None
        if made.motion is None
        else [signal(made.motion.position), signal(made.motion.velocity), signal(made.motion.acceleration)],
        "spectra": None
        if spectra is None
        else [signal(getattr(spectra, name)) for name in spectra.__slots__ if np.ndim(getattr(spectra, name)) == 1],
        "response": None
        if answering is None
        else {
            "frequency": signal(answering.frequency),
            "curves": [
                [signal(getattr(curve, name)) for name in ("magnitude", "low", "high", "phase")]
                for curve in answering.curves
            ],
            "modes": _named(answering.modes),
        },
    }


def predicted(driven: Any, values: Mapping[str, float], reference: Any, **noise: Any) -> Json:
    """Return the deviations that a test of a reference of 1 ms will give, and what is said of them."""
    made = predict_test(driven, _valued(values), planned_record(driven, reference, 1e-3), ji.Noise(**noise))
    return {"text": text(str(made)), "std": numbers(made.covariance.std)}


# Files

DRIVES: Mapping[str, Json] = {
    "cia402": {"rated_torque": 12.0, "counts_per_turn": 1048576},
    "generic": {},
    "kuka": {"axis": 1},
    "sinamics": {"counts_per_turn": 1048576},
    "twincat": {"rated_torque": 12.0, "counts_per_turn": 1048576},
    "ur-rtde": {"axis": 1, "torque_constant": 0.1},
}
"""Profiles of drives, with the numbers behind their units."""


def write(record: Any, path: Path, **given: Any) -> Path:
    """Write a record to a file."""
    ji.write(record, path, **_keywords(given))
    return path


def written_and_read(record: Any, path: Path) -> Json:
    """Return a record that was written under the names of its channels and read back."""
    ji.write(record, path)
    return recorded(ji.read(path, {name: name for name in record.channels}, kind="prismatic"))


def by_profile(record: Any, path: Path, profile: str, columns: Mapping[str, str]) -> Json:
    """Return a record of a revolute joint that was written as a drive of a profile logs it, and read back."""
    drive = ji.Drive(profile, **DRIVES[profile])
    ji.write(record, path, columns, drive=drive, kind="revolute")
    return recorded(ji.read(path, columns, drive=drive, kind="revolute"))


def read_resampled(path: Path, sample_time: float, method: Any) -> Json:
    """Return a record with a clock that is not uniform, brought to one that is."""
    names = {"torque": "torque", "reference": "reference"}
    return recorded(ji.read(path, names, resample=Resampling(sample_time, method), kind="prismatic"))


def behind_gear(path: Path, model: str, gear: Mapping[str, Any], numbers_of_law: Mapping[str, Any]) -> tuple[Any, Any]:
    """Return loop and record of a joint behind a gear; the law's numbers, and the file's signals, are the motor's."""
    between = ji.Transmission(**_keywords(gear))
    of = joint(model, between.kind, gear=gear)
    driven = ji.ClosedLoop(of, law("cascade", **numbers_of_law, ratio=between.torque("motor")))
    names = {name: name for name in ("torque", "reference", "motor_position", "load_position")}
    if model == "rigid":  # its load moves with the motor
        del names["load_position"]
    return driven, ji.read(path, names, kind=between.load, transmission=between)


# The paper


def published() -> Json:
    """Return every number of the published tables and what follows from them."""
    return {
        str(n): {
            "rows": {_name(name): [str(cell) for cell in cells] for name, cells in table.rows.items()},
            "recomputed": {row.name: [list(row.printed), list(row.recomputed)] for row in recomputed(table).rows},
            "misprints": sorted([str(column), _name(name)] for column, name in find_misprints(table)),
        }
        for n, table in sorted(TABLES.items())
    }


def errata() -> Json:
    """Return the numbers in the errata, which are all computed."""
    return {
        str(place): {
            "printed": _NUMBER.findall(erratum.printed),
            "recomputed": _NUMBER.findall(erratum.recomputed),
        }
        for place, erratum in enumerate(ERRATA, 1)
    }


def reproduction(seed: int) -> Json:
    """Run the paper on its twin."""
    made = reproduce(seed)

    def experiment(part: Any) -> Json:
        return {
            "noise": number(part.axis.noise),
            "idim": _brief(part.idim),
            "didim": _brief(part.didim),
            "best": _brief(part.best),
            "idim_simulated": _validation(ji.to_dict(part.idim_simulated)),
            "didim_direct": _validation(ji.to_dict(part.didim_direct)),
        }

    return {
        "rigid": _brief(made.rigid),
        "first": experiment(made.first),
        "second": experiment(made.second),
        "variations": {method: _named(made.variations(method)) for method in ("idim", "didim")},
        "relative_errors": {way: [_named(one) for one in made.relative_errors(way)] for way in ("DIDIM", "IDIM")},
        "without_damping": {
            "estimate": _brief(made.without_damping),
            "residual_change": number(made.damping_residual),
            "shifts": _named(made.damping_shifts),
        },
    }


def _brief(found: Any) -> Json:
    answer = estimate(ji.to_dict(found))
    keys = (
        "parameters", "raw_error_percent", "filtered_error_percent", "rows", "condition", "simulations", "converged",
        "verdicts", "combinations", "residuals", "warnings",
    )  # fmt: skip
    return {key: answer[key] for key in keys}
