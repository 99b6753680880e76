"""`jointid export`: an estimate in another tool's language."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import Parameter

from jointid.apps.cli.options import Changes

Language = Literal["joint-file", "state-space", "matlab", "mjcf", "urdf", "modelica"]


def export(
    joint: Path,
    /,
    *,
    estimate: Path,
    changes: Changes = (),
    out: Path,
    format: Language | None = None,  # noqa: A002
    side: Literal["motor", "load"] | None = None,
    fixed: Annotated[bool, Parameter(negative=())] = False,
    period: float | None = None,
    delay: float | None = None,
    timestep: float | None = None,
) -> None:
    """Write an estimate for another tool, and say what that tool's language does not hold of it.

    The ending of the file says for which: .toml a joint file with the values filled in, .json a linear state space for
    SciPy and python-control, .m the same for MATLAB, .xml MuJoCo's MJCF, .urdf URDF, .mo Modelica.

    Args:
        joint: the joint file (TOML).
        estimate: what identify --json wrote.
        changes: a key of the joint file and its value, as method.frequency=30; may be given several times.
        out: the file to write.
        format: the language, instead of the one the ending of the file means.
        side: of a transmission, whose numbers are written; without it the load's for URDF and MJCF, and else the side
            that was identified.
        fixed: of a joint file: the values are kept, instead of being starts.
        period: of a state space, in s, to sample it with; without it the record's sample time.
        delay: of a state space, in s, from a sample of the torque to its effect; without it as identified.
        timestep: of MJCF, in s.
    """
    from jointid.apps.cli.console import check_outputs, show
    from jointid.common.errors import RecordError
    from jointid.config import load
    from jointid.output import json as answers
    from jointid.output.export import export as run
    from jointid.output.export import find_language, read_estimated

    check_outputs(None, out)
    if out.exists() and out.samefile(estimate):
        raise RecordError(f"{out} is the estimate itself, which would be replaced; name another file.")
    given = {"values": "fixed" if fixed else None, "period": period, "delay": delay, "timestep": timestep}
    settings: dict[str, Any] = {key: value for key, value in given.items() if value is not None}
    language = find_language(format or out.suffix.lower()).name
    file = load(joint, changes).override(friction=answers.read_friction(estimate))
    if language == "joint-file":
        settings |= {"file": file, "folder": out.parent}
    exported = run(read_estimated(estimate, file.joint, file.name), language, side=side, **settings)
    exported.save(out)
    show(exported)
    show(f"written: {out}")
