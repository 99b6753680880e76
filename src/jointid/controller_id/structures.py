"""Controller structures: parts, open parameters and the resulting controllers."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import product
from typing import Any, Literal

from jointid.models.controllers import (
    PD,
    PID,
    Cascade,
    Controller,
    Filter,
    FirstOrder,
    Interpolation,
    Notch,
    SecondOrder,
)

Law = Literal["P-P", "P-PI", "PD", "PID"]

MEANS = (2, 3, 4, 6, 8, 16)  # samples of the moving averages that are tried
VELOCITY_FILTERS = ("none", *(f"mean {n}" for n in MEANS), "first order", "second order")
COMMON = ("none", "mean 2", "mean 4", "first order", "second order")  # velocity filters that are tried in every law
TORQUE_FILTERS = ("none", "first order", "second order", "notch")

RATES = (2, 4, 8, 16)  # periods per log sample of a loop faster than the log
SLOWER = (2, 4, 8)  # loop periods per evaluation of a slower position loop
INTERPOLATIONS: tuple[Interpolation, ...] = ("linear", "cubic", "hold")  # of its reference, the plainest first
AVERAGED = (2, 3, 4, 6, 8, 10, 12, 16, 20)  # samples over which the reference is averaged
LATE = (1, 2, 3, 4)  # delays of the logged torque, in samples
VELOCITY, ACCELERATION, COULOMB, CONSTANT = "velocity", "acceleration", "coulomb", "constant"
FEEDFORWARDS = (VELOCITY, ACCELERATION, COULOMB, CONSTANT)

INTEGRAL = "integral"
"""The torque that an integral holds at the first sample, in controller units: a number of the record, not the law."""


@dataclass(frozen=True, slots=True)
class Structure:
    """A law without its numbers.

    Attributes:
        law: "P-P" and "P-PI" are cascades; see `jointid.models.controllers.laws`.
        reference_velocity: of a PD or PID: "none", "difference", filtered like the position's, or "channel". Of a
            cascade: "none", "share" of the reference's difference, "full", or a share of the "channel".
        velocity_filter: "none", "mean 2", ..., "first order" or "second order".
        feedforward: others than the velocity's of a cascade, of `FEEDFORWARDS`.
        torque_filter: "none", "first order", "second order" or "notch".
        reference_delay: whether the law sees the reference later.
        late: samples by which the log shows the torque later than the position it follows from.
        rate: periods of the law in one sample of the log.
        interpolation: how a law that is faster than the log fills in its reference.
        average: samples of the log over which the reference is averaged, 0 for none.
        every, offset: of a cascade's position loop, in periods of the law.
        limited: whether the limit acts in the record.
    """

    law: Law = "P-P"
    reference_velocity: str = "none"
    velocity_filter: str = "none"
    feedforward: frozenset[str] = frozenset()
    torque_filter: str = "none"
    reference_delay: bool = False
    late: int = 0
    rate: int = 1
    interpolation: Interpolation = "linear"
    average: int = 0
    every: int = 1
    offset: int = 0
    limited: bool = False

    @property
    def cascade(self) -> bool:
        """True if it has a position loop around a velocity loop."""
        return self.law in ("P-P", "P-PI")

    @property
    def integrates(self) -> bool:
        """True if it has an integral."""
        return self.law in ("P-PI", "PID")

    @property
    def frame(self) -> Structure:
        """The plain law with its clocks and filters."""
        return replace(
            self, law="P-P", reference_velocity="none", feedforward=frozenset(), reference_delay=False, limited=False
        )

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers it leaves open, as `numbers_of` names them, and `INTEGRAL`."""
        names = ["position_gain", "velocity_gain" if self.cascade else "derivative_gain"]
        if self.integrates:
            names += ["integral_gain", INTEGRAL]
        if self.cascade and self.reference_velocity in ("share", "channel"):
            names.append("velocity_feedforward")
        names += [FIELDS[part] for part in FEEDFORWARDS if part in self.feedforward]
        names += _filter_names("velocity_filter", self.velocity_filter)
        names += _filter_names("torque_filters.0", self.torque_filter)
        if self.reference_delay:
            names.append("reference_delay")
        if self.limited:
            names.append("limit")
        return tuple(names)

    @property
    def parts(self) -> int:
        """Number of parts: parameters, and each delay, rate or offset not in a plain law."""
        clocks = (self.rate > 1, self.interpolation != "linear", self.average > 0, self.every > 1, self.late > 0)
        return len(self.names) + sum(clocks)

    def weight(self, rows: float) -> float:
        """Penalty in the criterion: Schwarz's log(rows) for each part.

        A clock costs 2 log(choices) more, by the extended criterion (Chen and Chen 2008, Biometrika 95(3)).
        """
        choices = (
            (len(RATES) * len(INTERPOLATIONS), self.rate > 1),
            (len(AVERAGED), self.average > 0),
            (sum(SLOWER), self.every > 1),
            (len(LATE), self.late > 0),
        )
        return self.parts * math.log(rows) + sum(2.0 * math.log(number) for number, chosen in choices if chosen)

    def __str__(self) -> str:
        """Describe the law and its additional parts."""
        said: list[str] = [self.law]
        if self.reference_velocity != "none":
            said.append(_REFERENCE_VELOCITY[self.cascade, self.reference_velocity])
        if self.feedforward:
            said.append(" and ".join(p for p in FEEDFORWARDS if p in self.feedforward) + " feed-forward")
        if self.velocity_filter != "none":
            said.append(f"velocity filter {_spell_filter(self.velocity_filter)}")
        if self.torque_filter != "none":
            said.append(f"torque filter {self.torque_filter}")
        if self.reference_delay:
            said.append("reference delayed")
        if self.average:
            said.append(f"reference averaged over {self.average} samples")
        if self.late:
            said.append(f"torque {self.late} samples late")
        if self.rate > 1:
            said.append(f"{self.rate} periods per sample" + _ON_REFERENCE[self.interpolation])
        if self.every > 1:
            said.append(f"position loop every {self.every} periods, from period {self.offset + 1}")
        return ", ".join(said)


@dataclass(frozen=True, slots=True, eq=False)
class NumberedStructure:
    """A structure with numbers and cost.

    Attributes:
        numbers: those the structure leaves open, or of a regression, those its torque is not linear in: of its filters,
            ki of a cascade, and the reference's delay.
        cost: sum of the squares of the whitened residual.
    """

    structure: Structure
    numbers: dict[str, float]
    cost: float


FIELDS = {
    VELOCITY: "viscous_feedforward",
    ACCELERATION: "acceleration_feedforward",
    COULOMB: "coulomb_feedforward",
    CONSTANT: "constant_feedforward",
}

_ON_REFERENCE = {"linear": "", "cubic": " on a curved reference", "hold": " on a held reference"}
_REFERENCE_VELOCITY = {
    (True, "share"): "velocity feed-forward",
    (True, "full"): "full velocity feed-forward",
    (True, "channel"): "velocity feed-forward from its channel",
    (False, "difference"): "on the reference's filtered difference",
    (False, "channel"): "on the reference's velocity channel",
}
_FILTERS: Mapping[str, Mapping[str, tuple[float, ...]]] = {
    "first order": {"time_constant": (0.5, 1.2, 3.0, 10.0)},
    "second order": {"frequency": (0.03, 0.07, 0.12, 0.18, 0.27), "damping": (0.7,)},
    "notch": {"frequency": (0.03, 0.06, 0.09, 0.13, 0.18, 0.27), "bandwidth": (0.035,), "depth": (0.2,)},
}
"""Numbers of the filters and where a search for them begins, in samples of the log and shares of its rate."""

INTEGRAL_GAINS = (3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1)  # starting values of a cascade's ki, as shares of the log's rate
_DELAYS = (0.3, 0.7, 1.3, 1.7, 2.3, 2.7, 3.3, 3.7)
"""Starting values of the reference's delay, in log samples: two in each, as it is interpolated linearly."""


def _filter_names(place: str, kind: str) -> list[str]:
    return [f"{place}.{name}" for name in _FILTERS.get(kind, {})]


def may_be_negative(name: str) -> bool:
    """Test for a number of either sign."""
    return name in (INTEGRAL, "constant_feedforward")


def _spell_filter(kind: str) -> str:
    word, _, count = kind.partition(" ")
    return f"mean of {count} samples" if word == "mean" else kind


def starts(structure: Structure, known: Mapping[str, float], sample_time: float) -> Iterator[dict[str, float]]:
    """Yield start values of nonlinear numbers: from a similar structure, or on a grid."""
    places: list[Iterable[dict[str, float]]] = []
    for place, kind in (("velocity_filter", structure.velocity_filter), ("torque_filters.0", structure.torque_filter)):
        names = _filter_names(place, kind)
        if all(name in known for name in names):
            places.append([{name: known[name] for name in names}])
        else:
            scale = {"time_constant": sample_time, "damping": 1.0, "depth": 1.0}
            grid = product(
                *([v * scale.get(n, 1.0 / sample_time) for v in values] for n, values in _FILTERS[kind].items())
            )
            places.append([dict(zip(names, one, strict=True)) for one in grid])
    if structure.cascade and structure.integrates:
        options = [share / sample_time for share in INTEGRAL_GAINS]
        given = known.get("integral_gain", 0.0)
        if "velocity_gain" not in known:  # kv kp ki of a cascade is the ki of a PID, its kv kp the kp
            given = given / known["position_gain"] if known.get("position_gain") else 0.0
        options = [given] if given else options
        places.append([{"integral_gain": ki} for ki in options])
    if structure.reference_delay:
        options = [known["reference_delay"]] if "reference_delay" in known else [n * sample_time for n in _DELAYS]
        places.append([{"reference_delay": delay} for delay in options])
    for parts in product(*places):
        yield {name: value for part in parts for name, value in part.items()}


def convert_numbers(structure: Structure, known: Mapping[str, float]) -> dict[str, float]:
    """Convert numbers from a similar law, else 0; ``kp kv`` of a cascade is a PD's kp."""
    given = dict(known)
    if structure.cascade and "derivative_gain" in given:
        given["velocity_gain"] = given.pop("derivative_gain")
        given["position_gain"] = given["position_gain"] / given["velocity_gain"] if given["velocity_gain"] else 0.0
        rate, stiffness = given["velocity_gain"], given["position_gain"] * given["velocity_gain"]
        given["integral_gain"] = given.get("integral_gain", 0.0) / max(stiffness, 1e-300)
        given.setdefault("velocity_feedforward", given.get("viscous_feedforward", 0.0) / max(rate, 1e-300))
    elif not structure.cascade and "velocity_gain" in given:
        given["derivative_gain"] = given.pop("velocity_gain")
        given["position_gain"] = given["position_gain"] * given["derivative_gain"]
        given["integral_gain"] = given.get("integral_gain", 0.0) * given["position_gain"]
    return {name: given.get(name, 0.0) for name in structure.names}


def bounds(name: str, sample_time: float, rate: int) -> tuple[float, float]:
    """Bounds of a parameter of a law with `rate` periods per log sample (`sample_time`, s)."""
    period = sample_time / rate
    last = name.rpartition(".")[2]
    if may_be_negative(name):
        return -math.inf, math.inf
    return {
        "time_constant": (1e-2 * period, 2e3 * period),
        "frequency": (2e-4 / period, 0.45 / period),
        "bandwidth": (2e-4 / period, 0.45 / period),
        "damping": (0.4, 3.0),
        "depth": (0.0, 1.0),
        "reference_delay": (0.0, 50 * sample_time),
    }.get(last, (0.0, math.inf))


def controller(structure: Structure, numbers: Mapping[str, float], period: float, gain: float) -> Controller:
    """Build the controller; `period` of the log in s, `gain` torque per controller unit."""
    own = {name: value for name, value in numbers.items() if "." not in name and name not in (INTEGRAL, "limit")}
    settings: dict[str, Any] = {"gain": gain, **own}
    if structure.limited:
        settings["limit"] = max(numbers["limit"], 1e-300)
    velocity, torque = filters_of(structure, numbers)
    if structure.velocity_filter != "none":
        settings["velocity_filter"] = velocity
    if structure.torque_filter != "none":
        settings["torque_filters"] = (torque,)
    if structure.late:
        settings["delay"] = structure.late * period
    if structure.average:
        settings["reference_average"] = structure.average * period
    own_period = period / structure.rate
    if structure.rate > 1:
        settings |= {"period": own_period, "interpolation": structure.interpolation}
    if structure.cascade:
        if structure.every > 1:
            settings |= {"position_period": structure.every * own_period}
            settings |= {"position_offset": structure.offset * own_period} if structure.offset else {}
        if structure.reference_velocity == "full":
            settings["velocity_feedforward"] = 1.0
        if structure.reference_velocity == "channel":
            settings["reference_velocity"] = "channel"
        return Cascade(**settings)
    settings["reference_velocity"] = structure.reference_velocity
    return PID(**settings) if structure.integrates else PD(**settings)


def filters_of(structure: Structure, numbers: Mapping[str, float]) -> tuple[Filter | tuple[float, ...], ...]:
    """Filters of a structure for velocity and torque."""
    return (
        _filter(structure.velocity_filter, "velocity_filter", numbers),
        _filter(structure.torque_filter, "torque_filters.0", numbers),
    )


def _filter(kind: str, place: str, numbers: Mapping[str, float]) -> Filter | tuple[float, ...]:
    if kind == "none":
        return (1.0,)
    if kind.startswith("mean"):
        samples = int(kind.split()[1])
        return (1.0 / samples,) * samples
    made = {name: numbers[f"{place}.{name}"] for name in _FILTERS[kind]}
    if kind == "first order":
        return FirstOrder(**made)
    return SecondOrder(**made) if kind == "second order" else Notch(**made)
