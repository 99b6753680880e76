"""`export`: an estimate in another tool's language, and the losses."""

from __future__ import annotations

import inspect
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from jointid.common.errors import MethodError
from jointid.common.files import write_whole
from jointid.common.text import join
from jointid.common.transmission import SIDES, Side
from jointid.estimation.result.estimate import Estimate
from jointid.models.controllers.servo_base import Controller, require_one_each
from jointid.models.robots.robot import Robot
from jointid.output.export.actuators import isaac_lab, mjlab
from jointid.output.export.bodies import Model, read_robot_model
from jointid.output.export.joint_file import joint_file
from jointid.output.export.joint_model import JointModel, controllers_of, pd_law
from jointid.output.export.mjcf import mjcf
from jointid.output.export.state_space import state_space, state_space_file
from jointid.output.export.urdf import urdf

__all__ = ["LANGUAGES", "Export", "export", "find_language", "state_space"]


_Write: TypeAlias = Callable[..., tuple[str | bytes, list[str]]]
LANGUAGES: Mapping[str, tuple[tuple[str, ...], _Write]] = {
    "joint-file": ((".toml",), joint_file),
    "state-space": ((".mat",), state_space_file),
    "mjcf": ((".xml", ".mjcf"), mjcf),
    "urdf": ((".urdf",), urdf),
    "isaac-lab": ((".py",), isaac_lab),
    "mjlab": ((), mjlab),
}
"""Every language: the endings of its files, and what returns the content of one and a sentence for each part that it
does not have; the keyword arguments of that are its settings."""
_BODIES = ("mjcf", "urdf", "isaac-lab", "mjlab")
"""Those whose joints move bodies: they hold robots, and of a transmission the numbers of the load's side."""


@dataclass(frozen=True, slots=True)
class Export:
    """A joint or a robot in another language.

    Attributes:
        format: name of the language.
        content: of the file.
        lost: parts of the joint that the language does not hold, a sentence each.
        note: how well the bodies of a robot fit its estimate; empty otherwise.
    """

    format: str
    content: bytes
    lost: tuple[str, ...]
    note: str = ""

    @property
    def text(self) -> str:
        """Content of a text file."""
        return self.content.decode()

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the file, text in UTF-8, over an existing one.

        Raises:
            RecordError: the file cannot be written.
        """
        write_whole(path, self.content)

    def __str__(self) -> str:
        """Return the losses, one on each line."""
        return "\n".join(f"lost in {self.format}: {sentence}" for sentence in self.lost) or (
            f"nothing of the joint is lost in {self.format}"
        )


def export(
    estimate: Estimate | Robot,
    language: str,
    *,
    side: Side | None = None,
    name: str | None = None,
    controllers: Sequence[Controller | None] = (),
    **settings: Any,
) -> Export:
    """Return an estimate in another tool's language.

    - "joint-file": TOML with the values filled in. Settings: `file`, the `File` it was identified with, whose text
      is kept; `values`, "start" (where the next search begins) or "fixed" (what is kept); `folder`, where it will be.
    - "state-space": linear, continuous and sampled, as a .mat file. Settings: `period` and `delay` in s, to sample
      with; without them the record's and the joint's.
    - "mjcf": motor and load with the spring between, friction of each, for MuJoCo; of a robot its bodies. Settings:
      `timestep` in s; `control`, "torque", or "pd" for the law of the controller.
    - "urdf": one joint with damping and friction, without the spring, for ROS. Of a robot its bodies. Settings:
      `model`, the URDF that the robot was read from, of which all else is kept; `locked`, see `robots.load_robot`.
    - "isaac-lab", "mjlab": actuators with gains, inertia, friction, delay and limit, for a simulator that has
      the links as bodies of its own. Settings: `timestep` of its physics in s.

    Args:
        estimate: from `identify` or `load_estimate`. Of a robot, bodies near the nominal ones that fit it are
            written; a `Robot` is written as it is.
        language: its name, or the ending of its files.
        side: of a transmission, "motor" or "load", whose numbers are written; without it the load's for URDF, MJCF
            and actuators, whose joints are those of a robot's links, and else the side that was identified.
        name: of the joint or the robot; by default "joint", or the name of the robot's model.
        controllers: of each joint, whose gains simulators take; without them those that it was identified under.
        settings: of the language.

    Raises:
        MethodError: there is no such language, setting or side, controllers are not one for each joint, or the
            language cannot hold this joint.
        JointFileError: the joint file cannot be read any more, or cannot express this.

    Example:
        >>> import jointid as ji
        >>> record = ji.twin("L19", noise="none").record
        >>> law = ji.controller.Cascade(position_gain=160.18, velocity_gain=243.45, gain=35.15)
        >>> loop = ji.ClosedLoop(ji.RigidJoint("prismatic"), law)
        >>> rigid = ji.identify(record, loop, filtering=ji.Filtering(cutoff=5.0))
        >>> print(ji.export(rigid, "urdf").lost[0][:16])
        a constant force
    """
    chosen = find_language(language)
    _, write = LANGUAGES[chosen]
    known = [key for key, one in inspect.signature(write).parameters.items() if one.kind is one.KEYWORD_ONLY]
    if unknown := [key for key in settings if key not in known]:
        raise MethodError(f"{chosen} has no setting {', '.join(unknown)}; it has: {', '.join(known)}.")
    for key in settings.keys() & {"timestep", "period", "delay"}:
        if not isinstance(settings[key], int | float | None):
            raise MethodError(f'The {key} of an export is a number of seconds; received "{settings[key]}".')
    if side not in (None, *SIDES):
        raise MethodError(f'A side is "motor" or "load"; received "{side}".')
    if not isinstance(estimate, Estimate | Robot):
        raise MethodError(f"What is exported is an estimate or a robot; received {type(estimate).__name__}.")
    given, note = controllers or controllers_of(estimate), ""
    if isinstance(estimate, Robot) or estimate.robot is not None:
        if side is not None or chosen not in _BODIES:
            others = join(_BODIES)
            raise MethodError(f"A robot is written as {others}, with all numbers behind its gears; leave the side out.")
        require_one_each(given, len(estimate if isinstance(estimate, Robot) else estimate.require_robot().model))
        bodies, note = read_robot_model(estimate)
        model = Model([pd_law(one) for one in given], whole=replace(bodies, name=name or bodies.name))
    else:
        require_one_each(given, 1)
        joint = JointModel.of(estimate, name or "joint", *given)
        joint = joint.on(side or ("load" if chosen in _BODIES and joint.side is not None else None))
        model = Model([joint.law], alone=joint)
    content, lost = write(model, **settings)
    return Export(chosen, content.encode() if isinstance(content, str) else content, tuple(lost), note)


def find_language(name: str) -> str:
    """Name of a language from its name or file suffix, any case.

    Raises:
        MethodError: there is none.
    """
    for language, (suffixes, _) in LANGUAGES.items():
        if name.lower() in (language, *suffixes):
            return language
    known = "; ".join(" ".join([one, *suffixes]) for one, (suffixes, _) in LANGUAGES.items())
    raise MethodError(f'"{name}" is no language that a joint is exported to; expected one of {known}.')
