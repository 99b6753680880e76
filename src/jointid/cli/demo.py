"""`jointid demo`: the paper's axis, from nothing to a figure, in a folder to play with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def demo(
    folder: Path = Path("jointid-demo"),
    /,
    *,
    seed: int = 1,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Make the digital twin of the paper's flexible axis and identify it as a rigid joint, at low frequency.

    Writes the record, the joint file, the answer and the figure; change the joint file and run
    `jointid identify FOLDER/joint.toml` to see what follows.

    Args:
        folder: where to write; it is made if it is not there.
        seed: of the noise.
        quiet: say nothing of the progress.
    """
    from jointid import answers
    from jointid.cli.console import compiling, progress, show
    from jointid.common.text import aligned, number
    from jointid.data.reading import write
    from jointid.estimation.identify import identify
    from jointid.jointfile import load
    from jointid.model.joints import rigid_sums
    from jointid.paper.twin import JOINT_FILE, twin
    from jointid.report.figures import save, torque_figure

    listener = progress(quiet)
    made = _folder(folder)
    listener("simulating 24 s of the paper's flexible axis, with an 8 % disturbance")
    with compiling(listener):
        axis = twin(seed=seed)
    write(axis.record, made / "record.csv")
    (made / "joint.toml").write_text(JOINT_FILE, encoding="utf-8")
    listener("identifying it from motor force and reference alone")
    file = load(made / "joint.toml")
    with compiling(listener):
        estimate = identify(
            file.record(), file.loop or file.joint, file.method, filtering=file.filtering,
            parameters=file.parameters, progress=listener,
        )  # fmt: skip
    answers.write(answers.estimate_answer(estimate), made / "estimate.json")
    save(torque_figure(estimate), made / "torque.png")
    show(estimate)
    truth = rigid_sums(axis.truth)
    rows = []
    for name, value in truth.items():
        found = estimate[name]
        assert found.value is not None
        rows.append((found.symbol, number(found.value), number(value), found.unit))
    show()
    show("The axis is flexible; below its resonance it shows the sums of its motor and load side:")
    show(aligned(("symbol", "identified", "true sum", "unit"), rows, (False, True, True, False)))
    show("The raw error is what lies above 5 Hz: the pulses, the resonance and the disturbance.")
    show()
    show(f"Written to {made}: record.csv, joint.toml, estimate.json, torque.png")
    show(f"Change the joint file, then: jointid identify {made / 'joint.toml'}")


def _folder(folder: Path) -> Path:
    from jointid.common.errors import RecordError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RecordError(f"{folder} cannot be made a folder ({error.strerror}); name another one.") from None
    return folder
