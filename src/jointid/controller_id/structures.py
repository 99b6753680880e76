"""Controller structures: parts, open parameters and the resulting controllers."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
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
        return replace(self, law="P-P", reference_velocity="none", feedforward=frozenset(), late=0)

    @property
    def names(self) -> tuple[str, ...]:
        """The numbers it leaves open, as `numbers_of` names them, and `INTEGRAL`."""
        names = ["position_gain", "velocity_gain" if self.cascade else "derivative_gain"]
        if self.integrates:
            names += ["integral_gain", INTEGRAL]
        if self.cascade and self.reference_velocity in ("share", "channel"):
            names.append("velocity_feedforward")
        names += [FIELDS[part] for part in FEEDFORWARDS if part in self.feedforward]
        for place, kind in (("velocity_filter", self.velocity_filter), ("torque_filters.0", self.torque_filter)):
            names += [f"{place}.{name}" for name in (_FILTERS[kind][1] if kind in _FILTERS else ())]
        if self.reference_delay:
            names.append("reference_delay")
        return tuple(names)

    @property
    def nonlinear(self) -> tuple[str, ...]:
        """Nonlinear numbers: of filters, ki of a cascade, and the reference's delay."""
        rates = ("reference_delay", *(("integral_gain",) if self.cascade else ()))
        return tuple(name for name in self.names if "." in name or name in rates)

    @property
    def _choices(self) -> list[int]:
        """Number of alternatives of each clock that differs from a plain law's."""
        clocks = (
            (len(RATES) * len(INTERPOLATIONS), self.rate > 1),
            (len(AVERAGED), self.average > 0),
            (sum(SLOWER), self.every > 1),
            (len(LATE), self.late > 0),
        )
        return [number for number, chosen in clocks if chosen]

    @property
    def parts(self) -> int:
        """Number of parts: parameters, delays, rates and offsets of the law."""
        return len(self.names) + len(self._choices) + (self.interpolation != "linear")

    def weight(self, rows: float) -> float:
        """Penalty in the criterion: Schwarz's log(rows) for each part.

        A clock costs 2 log(choices) more, by the extended criterion (Chen and Chen 2008, Biometrika 95(3)).
        """
        return self.parts * math.log(rows) + sum(2.0 * math.log(number) for number in self._choices)

    def __str__(self) -> str:
        """Describe the law and its additional parts."""
        word, _, count = self.velocity_filter.partition(" ")
        filtered = f"mean of {count} samples" if word == "mean" else self.velocity_filter
        parts = " and ".join(part for part in FEEDFORWARDS if part in self.feedforward)
        said = {
            _REFERENCE_VELOCITY.get((self.cascade, self.reference_velocity), ""): self.reference_velocity != "none",
            f"{parts} feed-forward": parts,
            f"velocity filter {filtered}": self.velocity_filter != "none",
            f"torque filter {self.torque_filter}": self.torque_filter != "none",
            "reference delayed": self.reference_delay,
            f"reference averaged over {self.average} samples": self.average,
            f"torque {self.late} samples late": self.late,
            f"{self.rate} periods per sample{_ON_REFERENCE[self.interpolation]}": self.rate > 1,
            f"position loop every {self.every} periods, from period {self.offset + 1}": self.every > 1,
        }
        return ", ".join([self.law, *(words for words, holds in said.items() if holds)])


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
_FILTERS: Mapping[str, tuple[Callable[..., Filter], tuple[str, ...]]] = {
    "first order": (FirstOrder, ("time_constant",)),
    "second order": (SecondOrder, ("frequency", "damping")),
    "notch": (Notch, ("frequency", "bandwidth", "depth")),
}
_SHARES = (0.03, 0.06, 0.09, 0.13, 0.18, 0.27)
_NUMBERS = {
    "time_constant": ((0.5, 1.2, 3.0, 10.0), 1, 1e-2, 2e3),
    "frequency": (_SHARES, -1, 2e-4, 0.45),
    "bandwidth": ((0.035,), -1, 2e-4, 0.45),
    "damping": ((0.7,), 0, 0.4, 3.0),
    "depth": ((0.2,), 0, 0.0, 1.0),
    "integral_gain": ((3e-4, 1e-3, 3e-3, 1e-2, 3e-2, 0.1), -1, 0.0, math.inf),
    "reference_delay": ((0.3, 0.7, 1.3, 1.7, 2.3, 2.7, 3.3, 3.7), 1, 0.0, 800.0),
}
"""Where a search for a number begins, the power of the period that is its unit, and its bounds.

Delays begin twice in each sample, as the reference is interpolated linearly.
"""


def may_be_negative(name: str) -> bool:
    """Test for a number of either sign."""
    return name in (INTEGRAL, "constant_feedforward")


def starts(structure: Structure, known: Mapping[str, float], sample_time: float) -> Iterator[dict[str, float]]:
    """Yield start values of nonlinear numbers, from a similar law or grid."""
    known, names, options = dict(known), structure.nonlinear, []
    if (
        "derivative_gain" in known and "integral_gain" in known
    ):  # kv kp ki of a cascade is the ki of a PID, its kv kp the kp
        known["integral_gain"] /= known["position_gain"] or 1.0
    for name in names:
        place, _, last = name.rpartition(".")
        filled = all(other in known for other in names if other.rpartition(".")[0] == place) if place else name in known
        grid, power, *_ = _NUMBERS[last]
        options.append([known[name]] if filled else [value * sample_time**power for value in grid])
    for values in product(*options):
        yield dict(zip(names, values, strict=True))


def bounds(name: str, sample_time: float, rate: int) -> tuple[float, float]:
    """Bounds of a law's parameter; `rate` periods per `sample_time` (s)."""
    if may_be_negative(name):
        return -math.inf, math.inf
    _, power, low, high = _NUMBERS.get(name.rpartition(".")[2], ((), 0, 0.0, math.inf))
    unit = (sample_time / rate) ** power
    return low * unit, high * unit


def controller(structure: Structure, numbers: Mapping[str, float], period: float, gain: float) -> Controller:
    """Build the controller; `period` in s, `gain` in torque per controller unit."""
    own_period, velocity = period / structure.rate, structure.reference_velocity
    of_velocity, of_torque = filters_of(structure, numbers)
    settings: dict[str, tuple[Any, object]] = {  # and whether they are not those of a plain law
        "velocity_filter": (of_velocity, structure.velocity_filter != "none"),
        "torque_filters": ((of_torque,), structure.torque_filter != "none"),
        "delay": (structure.late * period, structure.late),
        "reference_average": (structure.average * period, structure.average),
        "period": (own_period, structure.rate > 1),
        "interpolation": (structure.interpolation, structure.rate > 1),
        "position_period": (structure.every * own_period, structure.every > 1),
        "position_offset": (structure.offset * own_period, structure.offset),
        "velocity_feedforward": (1.0, structure.cascade and velocity == "full"),
        "reference_velocity": (velocity, not structure.cascade or velocity == "channel"),
    }
    own = {name: value for name, value in numbers.items() if "." not in name and name != INTEGRAL}
    own_settings: dict[str, Any] = {name: value for name, (value, holds) in settings.items() if holds}
    kinds: dict[str, type[Cascade | PD | PID]] = {"P-P": Cascade, "P-PI": Cascade, "PD": PD, "PID": PID}
    return kinds[structure.law](**{"gain": gain, **own, **own_settings})


def per_controller_unit(structure: Structure, numbers: Mapping[str, float], gain: float) -> dict[str, float]:
    """Convert numbers to controller units; `gain` is torque per controller unit."""
    rates = ("position_gain", "integral_gain", "velocity_feedforward") if structure.cascade else ()
    kept = (*rates, "reference_delay")
    return {name: value if "." in name or name in kept else value / gain for name, value in numbers.items()}


def filters_of(structure: Structure, numbers: Mapping[str, float]) -> tuple[Filter | tuple[float, ...], ...]:
    """Filters of a structure for velocity and torque."""

    def build(kind: str, place: str) -> Filter | tuple[float, ...]:
        if kind in _FILTERS:
            made, names = _FILTERS[kind]
            return made(**{name: numbers[f"{place}.{name}"] for name in names})
        samples = _samples(kind)
        return (1.0 / samples,) * samples

    return build(structure.velocity_filter, "velocity_filter"), build(structure.torque_filter, "torque_filters.0")


def _samples(kind: str) -> int:
    """Samples that a filter averages; 0 for other filters."""
    word, _, count = kind.partition(" ")
    return int(count) if word == "mean" else int(word == "none")


def canonical(structure: Structure) -> Structure:
    """Canonical form of a law: the cascade, if equivalent, without impossible parts."""
    law, velocity, parts = structure.law, structure.reference_velocity, structure.feedforward
    plain = velocity == "difference" and structure.velocity_filter == "none"
    if law == "PD" and velocity == "none":
        law, velocity = "P-P", "share" if VELOCITY in parts else "none"
    elif not structure.cascade and plain:
        law, velocity, parts = "P-PI" if structure.integrates else "P-P", "full", parts - {VELOCITY}
    if structure.integrates:
        parts = parts - {CONSTANT}  # the integral's
    if law == "P-P" and velocity != "channel":
        parts = parts - {VELOCITY}  # the cascade has its own
    found = replace(structure, law=law, reference_velocity=velocity, feedforward=parts)
    if not found.cascade:
        found = replace(found, every=1, offset=0)
    return found if found.rate > 1 else replace(found, interpolation="linear")


def list_laws(structure: Structure, channel: bool) -> list[Structure]:
    """Canonical laws that differ in one part; `channel`: with a reference velocity."""
    own = ["channel"] if channel else []
    cascades: tuple[Law, ...] = ("P-P", "P-PI")
    others: tuple[Law, ...] = ("PD", "PID")
    laws = [*product(cascades, ("none", "share", "full", *own)), *product(others, ("difference", "none", *own))]
    tried = [replace(structure, law=law, reference_velocity=velocity) for law, velocity in laws]
    tried += [replace(structure, feedforward=structure.feedforward ^ {part}) for part in FEEDFORWARDS]
    tried += [replace(structure, late=n) for n in (0, *LATE)]
    return _others(tried, structure)


def list_frames(structure: Structure) -> list[Structure]:
    """Canonical structures with another filter, clock or delay of the reference."""
    velocity, torque = structure.velocity_filter, structure.torque_filter
    tried = [replace(structure, velocity_filter=one) for one in VELOCITY_FILTERS]
    tried += [replace(structure, torque_filter=one) for one in TORQUE_FILTERS]
    if torque in VELOCITY_FILTERS and velocity in TORQUE_FILTERS:  # in the other place
        tried.append(replace(structure, velocity_filter=torque, torque_filter=velocity))
        law: Law = "PID" if structure.integrates else "PD"
        tried.append(replace(tried[-1], law=law, reference_velocity="difference"))
    tried.append(replace(structure, reference_delay=not structure.reference_delay, average=0))
    if structure.reference_delay or structure.average:  # a mean is late, too
        near = (structure.average - 1, structure.average + 1) if structure.average else ()
        tried += [replace(structure, average=n, reference_delay=False) for n in (0, *AVERAGED, *near) if n != 1]
    for rate in sorted({structure.rate // 2, structure.rate, 2 * structure.rate} & {1, *RATES}):
        slower = rate if structure.every > 1 else 1  # a slower position loop is as fast as the log
        count = _samples(velocity) * rate / structure.rate  # of a mean over the same time
        filters = {velocity, "none" if count == 1 else f"mean {count:.0f}"} & set(VELOCITY_FILTERS)
        tried += [
            replace(structure, rate=rate, interpolation=way, every=slower, offset=0, velocity_filter=one)
            for way, one in product(INTERPOLATIONS, sorted(filters))
        ]
    pairs = [(structure.rate, 0)] if structure.rate > 1 else [(n, k) for n in SLOWER for k in range(n)]
    tried += [replace(structure, every=every, offset=offset) for every, offset in [(1, 0), *pairs]]
    return _others(tried, structure)


def _others(tried: Iterable[Structure], structure: Structure) -> list[Structure]:
    return [one for one in dict.fromkeys(map(canonical, tried)) if one != structure]
