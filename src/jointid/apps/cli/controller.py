"""`jointid controller`: a joint file and a record with the motor position in, the controller out."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter

from jointid.apps.cli.options import Changes


def controller(
    joint: Path,
    /,
    *,
    record: Path | None = None,
    changes: Changes = (),
    json: Path | None = None,
    write: Path | None = None,
    quiet: Annotated[bool, Parameter(name=["--quiet", "-q"], negative=())] = False,
) -> None:
    """Learn the controller from a record that has reference, motor position and torque.

    Args:
        joint: the joint file (TOML); of its [controller], if it has one, the gain is read, and what the
            record does not show of limit and delay.
        record: the record, instead of the one the joint file names.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        json: also write the answer as JSON to this file.
        write: also write the joint file, with the learned [controller], to this file; all else, comments too, stays as
            it is, but for the paths of records, which from another folder lead to the same files.
        quiet: say nothing of the progress.
    """
    from jointid import learn_loop
    from jointid.apps.cli.console import check_outputs, progress, show
    from jointid.config import controller_text, load
    from jointid.config.write_controller import save

    check_outputs(None, json, write)
    file = load(joint, changes)
    gain = 1.0 if file.controller is None else getattr(file.controller, "gain", 1.0)
    learned = learn_loop(
        file.record(record),
        gain=gain,
        transmission=file.joint.transmission,
        declared=file.controller,
        progress=progress(quiet),
    )
    show(f"{learned}\n\n{controller_text(learned.controller, learned.transmission).rstrip()}")
    if json is not None:
        from jointid.output import json as answers

        answers.write(answers.to_dict(learned), json)
    if write is not None:
        save(learned, file, write)
        show(f"written: {write}")
