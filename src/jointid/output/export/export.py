"""The verb: an estimate in another tool's language, and what that language loses of it."""

from __future__ import annotations

import os
from dataclasses import Field, dataclass, fields, replace
from pathlib import Path
from typing import Any, ClassVar, Protocol, TypeAlias

from jointid.common.errors import MethodError, RecordError
from jointid.common.transmission import SIDES, Side
from jointid.estimation.result.estimate import Estimate
from jointid.models.joints import Joint
from jointid.output.export.joint_model import JointModel, joint_model
from jointid.output.export.joint_toml import JointToml
from jointid.output.export.linear import Matlab, StateSpaceJson
from jointid.output.export.mjcf import Mjcf
from jointid.output.export.modelica import Modelica
from jointid.output.export.state_space import StateSpace, linear_part
from jointid.output.export.urdf import Urdf
from jointid.output.json import estimate_answer
from jointid.output.json.reading import read_answer

Known: TypeAlias = Estimate | Estimate | Estimate | JointModel
"""Results that can be exported: those that hold the parameters of a joint."""


class Exporter(Protocol):
    """A language: a frozen dataclass whose fields are the settings of what it writes.

    Attributes:
        name: what `export` and the command line call it.
        described: what it is, in a line.
        suffixes: the endings of its files, in lower case, with the dot.
        side: of a transmission, whose numbers it has unless another is asked for; None: those that were identified.
    """

    name: ClassVar[str]
    described: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]]
    side: ClassVar[Side | None]
    __dataclass_fields__: ClassVar[dict[str, Field[Any]]]

    def lost(self, model: JointModel) -> tuple[str, ...]:
        """Return a sentence for each part of the joint that the text does not have."""
        ...

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            JointidError: the language cannot hold this joint.
        """
        ...


EXPORTERS: tuple[type[Exporter], ...] = (JointToml, StateSpaceJson, Matlab, Mjcf, Urdf, Modelica)
"""Every language there is."""


@dataclass(frozen=True, slots=True)
class Export:
    """A joint in another language.

    Attributes:
        format: name of the language.
        text: of the file.
        lost: what the language does not hold of the joint, a sentence for each.
    """

    format: str
    text: str
    lost: tuple[str, ...]

    def save(self, path: str | os.PathLike[str]) -> None:
        """Write the text in UTF-8; a file that is there is replaced.

        Raises:
            RecordError: the file cannot be written.
        """
        try:
            Path(path).write_text(self.text, encoding="utf-8", newline="\n")
        except OSError as error:
            raise RecordError(f"{path} cannot be written ({error.strerror}); choose another place.") from None

    def __str__(self) -> str:
        """Return what is lost, a line for each."""
        return "\n".join(f"lost in {self.format}: {sentence}" for sentence in self.lost) or (
            f"nothing of the joint is lost in {self.format}"
        )


def export(estimate: Known, exporter: str | Exporter, *, side: Side | None = None, name: str | None = None) -> Export:
    """Return an estimate in another tool's language.

    Args:
        estimate: what `identify` returned, or what `read_estimated` read.
        exporter: the name of a language, or one with its settings: `Mjcf(timestep=1e-4)`.
        side: of a transmission, "motor" or "load", whose numbers are written; without it the load's for URDF and MJCF,
            whose joints are those of a robot's links, and else the side that was identified.
        name: what the joint is called; without it "joint", or the name it was read with.

    Raises:
        MethodError: there is no such language or side, or the language cannot hold this joint.
        JointFileError: see `JointToml`.

    Example:
        >>> import jointid as ji
        >>> record = ji.twin("L19", noise="none").record
        >>> loop = ji.ClosedLoop(ji.RigidJoint(), ji.Cascade(kp=160.18, kv=243.45, gain=35.15))
        >>> rigid = ji.identify(record, loop, filtering=ji.Filtering(cutoff=5.0))
        >>> print(ji.export(rigid, "urdf").lost[0][:16])
        a constant force
    """
    made = exporter_named(exporter) if isinstance(exporter, str) else exporter
    if side not in (None, *SIDES):
        raise MethodError(f'A side is "motor" or "load"; received "{side}".')
    model = _model(estimate, name)
    usual = made.side if model.side is not None else None
    model = model.on(side or usual)
    return Export(made.name, made.text(model), made.lost(model))


def state_space(estimate: Known, *, side: Side | None = None) -> StateSpace:
    """Return the linear part of a joint: from torque to positions and velocities; `sampled` makes it discrete.

    Args:
        estimate: see `export`.
        side: of a transmission, whose torque and motion; without it the side that was identified.

    Raises:
        MethodError: a value is refused, no joint can have it, or there is no such side.
    """
    return linear_part(_model(estimate, None).on(side))


def read_estimated(path: str | os.PathLike[str], joint: Joint, name: str | None = None) -> JointModel:
    """Return what the file of an answer says of a joint, for `export`.

    Args:
        path: of what `identify --json`, `together --json` or `long --json` wrote.
        joint: the model its values belong to.
        name: what the joint is called.

    Raises:
        RecordError: the file cannot be read, is no such answer, or belongs to another joint.
    """
    return joint_model(read_answer(path), joint, name, str(path))


def exporter_named(name: str, **settings: Any) -> Exporter:
    """Return the language of that name, with settings.

    Raises:
        MethodError: there is no such language, or it has no such setting.
    """
    for made in EXPORTERS:
        if made.name == name:
            return _set(made, settings)
    known = "; ".join(f"{made.name} ({', '.join(made.suffixes)})" for made in EXPORTERS)
    raise MethodError(f'"{name}" is no language that a joint is exported to; expected one of {known}.')


def exporter_of(path: str | os.PathLike[str], **settings: Any) -> Exporter:
    """Return the language that the ending of a file's name means, with settings.

    Raises:
        MethodError: it means none, or the language has no such setting.
    """
    suffix = Path(path).suffix.lower()
    for made in EXPORTERS:
        if suffix in made.suffixes:
            return _set(made, settings)
    return exporter_named(suffix)


def _set(made: type[Exporter], settings: dict[str, Any]) -> Exporter:
    known = [field.name for field in fields(made)]
    unknown = [name for name in settings if name not in known]
    if unknown:
        has = ", ".join(known) or "none"
        raise MethodError(f"{made.name} has no setting {', '.join(unknown)}; it has: {has}.")
    return made(**settings)


def _model(estimate: Known, name: str | None) -> JointModel:
    match estimate:
        case JointModel():
            return estimate if name is None else replace(estimate, name=name)
        case Estimate():
            answer = estimate_answer(estimate)
        case _:
            raise MethodError(
                f"What is exported is an estimate, of one record or of several; received {type(estimate).__name__}."
            )
    return joint_model(answer, estimate.settings.joint, name)
