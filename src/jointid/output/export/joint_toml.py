"""The joint file with the identified values filled in: what `identify` and `simulate` read again."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import ClassVar, Literal

from jointid.common.errors import JointFileError, MethodError
from jointid.common.transmission import Side
from jointid.config import JointFile, dumps, loads, with_parameters, with_paths
from jointid.config.serialise import parameter_table
from jointid.estimation.result.params import EstimatedParameter
from jointid.models.parameters import Parameter
from jointid.output.export.joint_model import JointModel
from jointid.output.export.naming import number
from jointid.output.export.provenance import effects_left_out, interval, remarks

_STARTS = (
    'jointid simulate takes these starts; identify begins there with method.start = "given" (rigid), or by itself.'
)


@dataclass(frozen=True, slots=True)
class JointToml:
    """A joint file (TOML): that of the estimate, with its values.

    Attributes:
        file: the joint file the joint was identified with; its text, comments too, is kept but for [parameters].
        values: "start": where the next search begins; "fixed": what is kept.
        folder: where it will stand, from which the paths of its records lead to the same files; the same folder where
            None.

    Raises:
        MethodError: there are no such values.
    """

    file: JointFile | None = None
    values: Literal["start", "fixed"] = "start"
    folder: Path | None = None

    name: ClassVar[str] = "joint-file"
    described: ClassVar[str] = "TOML: the joint file with the values filled in"
    suffixes: ClassVar[tuple[str, ...]] = (".toml",)
    side: ClassVar[Side | None] = None

    def __post_init__(self) -> None:
        if self.values not in ("start", "fixed"):
            raise MethodError(f'The values of a joint file are "start" or "fixed"; received "{self.values}".')

    def lost(self, model: JointModel) -> tuple[str, ...]:
        """Return a sentence for each value that the text does not have."""
        refused = [p.name for p in self._left_out(model) if p.value is None]
        outside = [p for p in self._left_out(model) if p.value is not None]
        lost = [f"what the record does not tell: {', '.join(refused)}"] if refused else []
        lost += [f"{p.name}, which is outside its bounds: {interval(p)}" for p in outside]
        return (*lost, *effects_left_out(model))

    def text(self, model: JointModel) -> str:
        """Return the file's text.

        Raises:
            MethodError: there is no joint file to fill in, or it has its numbers on the other side.
            JointFileError: the joint file cannot be read any more, or cannot say this.
        """
        file = self._file(model)
        filled = replace(file, parameters=dict(self._parameters(model)))
        head = [*remarks(model, self.lost(model)), *([_STARTS] if self.values == "start" else [])]
        known = {p.name: p for p in file.joint.parameters}
        lines = [f"{name} = {_toml(p, known[name])}" for name, p in filled.parameters.items()]
        written = "\n".join(["[parameters]", *(f"# {line}" for line in head), *lines, ""])
        before = file.path.parent
        made = with_paths(_filled(file, filled, written), before, before if self.folder is None else self.folder)
        loads(made)  # which refuses what could not be read again
        return made

    def _file(self, model: JointModel) -> JointFile:
        if self.file is None:
            raise MethodError(
                "A joint file is made from the one the joint was identified with, which has its record and controller; "
                "give it as JointToml(file=load(...))."
            )
        if self.file.joint != model.joint:
            raise MethodError(
                "The joint file is of another joint than the estimate: their model, kind, friction, gravity or "
                "transmission differ; give the one it was identified with."
            )
        transmission = model.joint.transmission
        if transmission is not None and model.side != transmission.side:
            raise MethodError(
                f"The numbers are asked of the {model.side} side, and this joint file has them on the other; leave the "
                "side out, or change transmission.side in it and identify again."
            )
        return self.file

    def _parameters(self, model: JointModel) -> Iterator[tuple[str, Parameter]]:
        """Yield the parameters that the file says something of; what was fixed in it stays as it is."""
        file, without = self._file(model), {p.name for p in self._left_out(model)}
        for declared, found in zip(file.joint.parameters, model.parameters, strict=True):
            known = file.parameters.get(declared.name, declared)
            if known.free and declared.name not in without:
                assert found.value is not None
                yield declared.name, replace(known, free=self.values == "start", start=found.value)
            elif declared.name in file.parameters:
                yield declared.name, known

    def _left_out(self, model: JointModel) -> Iterator[EstimatedParameter]:
        """Yield what a joint file cannot have: values that are refused, or outside their bounds."""
        file = self._file(model)
        for declared, found in zip(file.joint.parameters, model.parameters, strict=True):
            known = file.parameters.get(declared.name, declared)
            told = found.value is not None and known.lower <= found.value <= known.upper
            if known.free and not told:
                yield found


def _filled(file: JointFile, filled: JointFile, written: str) -> str:
    """Return the file's own text with its parameters replaced, or all of it anew where that would not say the same."""
    try:
        text = with_parameters(file.path.read_text(encoding="utf-8-sig"), written)
        if loads(text).tables() == filled.tables():
            return text
    except (OSError, JointFileError):  # it was made by a program, or changed since
        pass
    return with_parameters(dumps(filled), written)


def _toml(parameter: Parameter, model: Parameter) -> str:
    table = parameter_table(parameter, model)
    if not isinstance(table, dict):
        return number(table)
    return f"{{ {', '.join(f'{key} = {number(value)}' for key, value in table.items())} }}"
