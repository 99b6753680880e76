"""The files of a record, and how they are read; records of a fit of several."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from jointid.common.errors import JointFileError
from jointid.common.settings import add_settings_to_docstring, declare, setting
from jointid.common.units import units_of
from jointid.estimation.methods.registry import MODELS, ROBOT
from jointid.models.robots.inertial import MassProperties, is_physical
from jointid.records.formats import format_of
from jointid.records.resampling import Resampling


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Source:
    """The file of the record, and how it is read; see `jointid.records.reading`."""

    file: str | None = setting(None, "path of the record, from the joint file's folder", accept=format_of)
    time: str | None = setting(
        None, "name of the time column; without it, and without a sample time, the column called t or time"
    )
    time_unit: str | None = setting(
        None, "unit of the time column; without it the one in its name, as in Time [ms], or s", choices=units_of("time")
    )
    sample_time: float | None = setting(
        None, "time between samples, where there is no time column; beside one the two must agree", unit="s", above=0
    )
    start: float | None = setting(None, "first instant to read, of the log's own clock", unit="s")
    stop: float | None = setting(None, "last instant to read, of the log's own clock", unit="s")
    torque: Literal["logged", "from_controller"] | None = setting(
        None,
        "whether the torque is a channel of the record, or what the controller outputs for the motor position; without "
        "it logged, or for DIDIM from the controller where no torque channel is declared",
    )
    part: int | None = setting(
        None, "which part between jumps of the clock to read, counted from 1; 0 takes the longest", at_least=0
    )
    options: Mapping[str, Any] = field(default_factory=dict)  # of the format's reader
    resample: Resampling | None = setting(
        None,
        "to which uniform clock all channels are brought, and how; without it a clock that is not uniform is refused",
    )

    def __post_init__(self) -> None:
        if self.file is not None:
            format_of(self.file, **self.options)


@add_settings_to_docstring
@dataclass(frozen=True, slots=True)
class Run:
    """One of several records that are identified together."""

    file: str = field(metadata=declare("path of the record, from the joint file's folder", accept=format_of))
    added_inertia: float = setting(
        0.0,
        "what is known to have been added to the load, as it is there, beyond what is shared",
        unit="kg or kg m2",
        at_least=0,
        systems=MODELS,
    )
    own: tuple[str, ...] = setting(
        (),
        "names of parameters of this record's own, which the others do not share; the motor's state at the first "
        "sample always is",
        systems=MODELS,
    )
    payload_mass: float | None = setting(
        None, "of what the last link carries in this record beside the robot's model [kg]", above=0, systems=ROBOT
    )
    payload_center: tuple[float, float, float] = setting(
        (0.0, 0.0, 0.0),
        "its centre of mass in the frame of the last link [m]",
        systems=ROBOT,
    )
    payload_inertia: tuple[float, float, float, float, float, float] = setting(
        6 * (0.0,),
        "its inertia xx, xy, xz, yy, yz, zz about that centre, along the axes of the last link [kg m2]",
        systems=ROBOT,
    )

    def __post_init__(self) -> None:
        stated = any((*self.payload_center, *self.payload_inertia))
        if (stated and self.payload_mass is None) or (self.payload and not is_physical(np.array(self.payload))):
            raise JointFileError(
                f"payload_inertia {list(self.payload_inertia)} with payload_mass = {self.payload_mass} is of no body; "
                "expected a mass, and principal moments not below 0, none above the sum of the others: correct them."
            )

    @property
    def payload(self) -> tuple[float, ...]:
        """`Record.payload` of what the last link of a robot carries; empty without a mass."""
        if self.payload_mass is None:
            return ()
        inertia = np.zeros((3, 3))
        inertia[np.triu_indices(3)] = self.payload_inertia
        body = MassProperties(self.payload_mass, np.array(self.payload_center), inertia + np.triu(inertia, 1).T)
        return tuple(map(float, body.inertial))
