"""`jointid demo`: the paper's axis, from nothing to a figure, in a folder to play with."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

if TYPE_CHECKING:
    from jointid import Estimate


def demo(
    folder: Path = Path("jointid-demo"),
    /,
    *,
    seed: int = 1,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Make the digital twin of the paper's flexible axis and identify it, its stiffness too, from torque alone.

    Writes the record, the joint file, the answer and the figure; change the joint file and run
    `jointid identify FOLDER/joint.toml` to see what follows.

    Args:
        folder: where to write; it is made if it is not there.
        seed: of the noise.
        quiet: say nothing of the progress.
    """
    from jointid import identify, twin, write
    from jointid.apps.cli.console import make_folder, progress, ready, show
    from jointid.common.errors import RecordError
    from jointid.common.text import aligned, number
    from jointid.config import load
    from jointid.diagnostics.check_loop import add_loop_verdict
    from jointid.output import json as answers
    from jointid.output.figures.figures import save, torque_figure
    from jointid.paper.twin import JOINT_FILE

    listener = progress(quiet)
    made = make_folder(folder)
    listener("simulating 24 s of the paper's flexible axis, with an 8 % disturbance")
    ready(listener)
    axis = twin(seed=seed)
    write(axis.record, made / "record.csv")
    try:
        (made / "joint.toml").write_text(JOINT_FILE, encoding="utf-8")
    except OSError as error:
        raise RecordError(f"{made / 'joint.toml'} cannot be written ({error.strerror}); name another folder.") from None
    listener("identifying it from motor force and reference alone")
    file = load(made / "joint.toml")
    logged = file.record()
    estimate = identify(
        logged, file.loop or file.joint, file.method, filtering=file.filtering, parameters=file.parameters,
        progress=listener,
    )  # fmt: skip
    estimate = add_loop_verdict(estimate, logged)
    answers.write(answers.to_dict(estimate), made / "estimate.json")
    save(torque_figure(estimate), made / "torque.png")
    show(estimate)
    rows = []
    for name, truth in (axis.truth | _sums(axis.truth)).items():
        value, std, symbol, unit = _found(estimate, name)
        rows.append((symbol, number(value), number(2 * std, 2), number(truth), unit))
    show()
    show("Beside the truth; torque alone knows the two viscous frictions, and the two Coulomb ones, by their sum:")
    show(aligned(("symbol", "identified", "2 sigma", "truth", "unit"), rows, (False, True, True, True, False)))
    show()
    show(f"Written to {made}: record.csv, joint.toml, estimate.json, torque.png")
    show(f"All of it on one page: jointid report {made / 'joint.toml'} --html report.html")
    show(f"Change the joint file, then: jointid identify {made / 'joint.toml'}")


def _sums(values: Mapping[str, float]) -> dict[str, float]:
    return {name: values[f"motor_{name}"] + values[f"load_{name}"] for name in ("viscous", "coulomb")}


def _found(estimate: Estimate, name: str) -> tuple[float, float, str, str]:
    """Return value, deviation, symbol and unit of a parameter, or of the sum of both sides."""
    if name in estimate.values:
        found = estimate[name]
        return estimate.values[name], found.stderr or 0.0, found.symbol, found.unit
    motor, load = estimate[f"motor_{name}"], estimate[f"load_{name}"]
    value, std = estimate.params.total((motor.name, load.name))
    return value, std, f"{motor.symbol}+{load.symbol}", motor.unit
