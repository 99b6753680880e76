"""The numbers of a joint, and of masses and springs, as `kernels.engine` reads them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any, ClassVar, TypeAlias

import numpy as np
from numpy.typing import NDArray

from jointid.common.arrays import FloatArray
from jointid.common.errors import MethodError
from jointid.models.friction import Friction
from jointid.models.joints import Joint, RigidJoint
from jointid.models.springs import Spring
from jointid.simulation.kernels.tables import (
    BEGIN,
    COULOMB,
    COULOMB_BACK,
    COULOMB_DRIFT,
    HIGH,
    INERTIA,
    PER_TORQUE,
    SLIPS,
    WAVE,
    WINDING,
    Plant,
    Seeds,
)

AnyArray: TypeAlias = NDArray[Any]
Blocks: TypeAlias = list[tuple[int, int, FloatArray]]

IMAGINARY = 1e-30
"""A complex step: its square is nothing beside any value."""
NO_LINKS = np.zeros((1, 0, 10))
"""The inertials of a joint, which stands in no tree; and what no motor feels of any."""
HEAVY = 1e18
"""Inertia of a motor that is moved: what acts on one of 1e3 N m moves it by 1e-12 rad in a minute."""
_THIN = 1e-300  # m or rad: the width of a piece of none, in which a joint would never get on


def lower_mass(inertia: Any, offset: Any, law: Friction, values: Mapping[str, Any], prefix: str = "") -> AnyArray:
    """Return a mass in each band of its friction, (bands, MASS + 1); complex of complex values."""
    own = law.beside(values, prefix)
    length, *beside = (own[n] for n in ("presliding_distance", "viscous_drift", "coulomb_drift", "friction_per_torque"))
    winds = 1.0 / length if length != 0.0 else 0.0
    return np.array([[inertia, offset, *lines, winds, *beside, high] for high, lines in law.bands(values, prefix)])


def lower_spring(law: Spring, values: Mapping[str, Any]) -> AnyArray:
    """Return a spring in each of its pieces, (pieces, SPRING); complex of complex values."""
    own = law.beside(values)
    cubic, slider, slips = (own[name] for name in ("cubic_stiffness", "hysteresis_stiffness", "hysteresis_torque"))
    slides = slider / slips if slips != 0.0 else (math.nan if slider != 0.0 else 0.0)
    return np.array(
        [
            [
                p.stiffness,
                p.damping,
                cubic,
                slips,
                slides,
                p.torque - p.stiffness * p.deflection,
                p.deflection + i * _THIN,
            ]
            for i, p in enumerate(law.pieces(values))
        ]
    )


def assemble(
    masses: Sequence[AnyArray], springs: Sequence[AnyArray], places: FloatArray, pairs: Sequence[tuple[int, int]],
    motors: Sequence[int], carriers: Sequence[int],
) -> Plant:  # fmt: skip
    """Return the plant of lowered masses and springs, filled up to equal numbers of bands and pieces."""
    pieces = max(map(len, springs), default=1)
    lowered = []
    for spring in springs:
        beyond = np.repeat(spring[-1:], pieces - len(spring), axis=0)
        beyond[:, BEGIN] = math.inf
        lowered.append(np.vstack([spring, beyond]))
    bands = max(map(len, masses))
    whole = np.array([np.vstack([mass, np.repeat(mass[-1:], bands - len(mass), axis=0)]) for mass in masses])
    tied = np.array(pairs, dtype=np.uint64).reshape(-1, 2)
    of_springs = np.array(lowered) if lowered else np.zeros((0, pieces, BEGIN + 1))
    return Plant(whole, of_springs, places, tied, np.array(motors, dtype=np.uint64), np.array(carriers))


def is_possible(plant: Plant, duration: float, links: int = 0) -> bool:
    """Test for masses, springs and friction of a physical joint, for that many seconds.

    Masses are positive, stiffness, damping and friction at rest are not negative, and bands and pieces rise. Of links,
    the first masses, the rotor's inertia may be negative: motion tells its sum with the link alone.
    """
    masses, springs = plant.masses, plant.springs
    numbers = masses[..., :HIGH], springs[..., :BEGIN], plant.places
    rising = np.all(masses[:, 1:, HIGH] >= masses[:, :-1, HIGH]) and np.all(
        springs[:, 1:, BEGIN] >= springs[:, :-1, BEGIN]
    )
    if not (rising and all(np.all(np.isfinite(one)) for one in numbers)):
        return False
    rest, per_torque = masses[:, 0], masses[:, 0, PER_TORQUE]
    drift = rest[:, COULOMB_DRIFT]
    faded = np.min(rest[:, [COULOMB, COULOMB_BACK]], axis=1) + np.minimum(drift, 0.0) * duration
    cones = np.all(rest[:, COULOMB] + rest[:, COULOMB_BACK] >= 0) and np.all((drift >= 0) | (faded >= 0))
    unsigned = springs[..., [0, 1, SLIPS, SLIPS + 1]]
    return bool(
        cones and np.all(rest[links:, INERTIA] > 0) and np.all((per_torque >= 0) & (per_torque < 1))
        and np.all(rest[:, WINDING] >= 0) and np.all(unsigned >= 0)
    )  # fmt: skip


@dataclass(frozen=True, slots=True, eq=False)
class JointNumbers:
    """The numbers of a joint: a value for each of its parameters, by name.

    Attributes:
        heavy: inertia of a motor that follows a prescribed motion, its friction left out; 0 of one as the values say.
    """

    joint: Joint
    values: Mapping[str, Any]
    heavy: float = 0.0

    inertials: ClassVar[FloatArray] = NO_LINKS[0]
    delays: ClassVar[FloatArray] = np.zeros((0, 1))
    motors: ClassVar[list[int]] = [0]

    @property
    def names(self) -> frozenset[str]:
        """Names of the joint's parameters."""
        return names_of(self.joint)

    @property
    def count(self) -> int:
        """Number of masses: motor, load, and what swings of an elastic load."""
        swings = self.values.get("swinging_share", 0.0) > 0.0
        return 1 if self.joint.model == "rigid" else 2 + swings

    @property
    def plant(self) -> Plant:
        """Masses and springs as the kernels read them; complex ones of complex values."""
        joint, values = self.joint, self.values
        drive, places, friction = self.drive, joint.places(values), joint.friction
        if isinstance(joint, RigidJoint):
            return assemble([lower_mass(drive[0], drive[12], friction, values)], [], places, [], [0], [-1])
        beside = joint.spring.beside(values)
        share, stiffness, damping = (beside[f"swinging_{word}"] for word in ("share", "stiffness", "damping"))
        load, swings = drive[1], np.real(share) > 0.0
        if np.real(share) < 0.0:
            load = math.nan
        elif swings or stiffness + damping == 0.0:
            load = (1.0 - share) * load  # a share that is just beginning moves with the load on its spring
        masses = [
            lower_mass(drive[0], drive[12], friction, values, "motor_"),
            lower_mass(load, drive[13], friction, values, "load_"),
        ]
        springs = [lower_spring(joint.spring, values)]
        if swings:
            masses.append(np.array([[share * drive[1], *np.zeros(HIGH - 1), math.inf]]))
            springs.append(lower_spring(Spring(), {"stiffness": stiffness, "damping": damping}))
        pairs, carriers = [(0, 1), (1, 2)][: len(springs)], [-1, 0, 1][: len(masses)]
        plant = assemble(masses, springs, places, pairs, [0], carriers)
        if self.heavy:
            plant.masses[0, :, :HIGH] = 0.0
            plant.masses[0, :, INERTIA] = self.heavy
        return plant

    @property
    def drive(self) -> FloatArray:
        """The coefficients of a joint of straight lines, (14,), see `kernels.drive`.

        Raises:
            MethodError: a parameter has no value.
        """
        try:
            return self.joint.coefficients(self.values)
        except KeyError:
            missing = ", ".join(p.name for p in self.joint.parameters if p.name not in self.values)
            raise MethodError(
                f"A simulation needs a value for every parameter; {missing} has none: give one."
            ) from None

    def possible(self, duration: float) -> bool:
        """Return True if all numbers are physically possible for that many seconds."""
        if not self.joint.straight:
            return is_possible(self.plant, duration)
        row = self.drive.tolist()  # a few plain numbers take less time than an array of them
        cones = row[6] + row[7] >= 0 and row[10] + row[11] >= 0
        return all(map(math.isfinite, row)) and min(row[:2]) > 0 and min(row[2:4]) >= 0 and cones

    @property
    def straight(self) -> bool:
        """True if the laws are lines, and the motor as it is."""
        return self.joint.straight and not self.heavy

    def carrying(self, payload: Sequence[float]) -> JointNumbers:
        """Return the joint, which carries nothing beside its load."""
        del payload
        return self

    def with_heavy_motors(self, heavy: float) -> JointNumbers:
        """Return the joint with a motor so heavy that it follows a prescribed motion."""
        return replace(self, heavy=heavy)

    def not_zero(self) -> tuple[list[str], FloatArray]:
        """Return the parameters, and their values."""
        names = [p.name for p in self.joint.parameters]
        return names, np.array([self.values[name] for name in names], dtype=np.float64)

    def neighbours(self, name: str, share: float) -> tuple[JointNumbers, JointNumbers, float] | None:
        """Return the numbers with less and more of one, and the difference; None of what is no number of a joint."""
        if name not in self.names:
            return None
        value = float(self.values[name])
        step = share * (abs(value) or 1.0)
        return self.with_value(name, value - step), self.with_value(name, value + step), 2.0 * step

    def with_value(self, name: str, value: Any) -> JointNumbers:
        """Return the numbers with another value of one parameter."""
        return replace(self, values={**self.values, name: value})

    def blocks(self, names: Sequence[Any]) -> Blocks:
        """Return the derivatives of the plant's numbers by parameters, by a complex step; of others there are none."""
        found: Blocks = []
        for column, name in enumerate(names):
            if name not in self.names:
                continue
            moved = self.with_value(name, complex(self.values[name], IMAGINARY)).plant
            rows = [*moved.masses[..., :HIGH], *moved.springs, *moved.places[:, np.newaxis, :WAVE]]
            found += [(column, row, slope(own)) for row, own in enumerate(rows)]
        return found

    @staticmethod
    def links(names: Sequence[Any]) -> list[tuple[int, int, int]]:
        """Return the parameters that are numbers of links: none."""
        del names
        return []


@lru_cache(maxsize=64)
def names_of(joint: Joint) -> frozenset[str]:
    """Return the names of a joint's parameters."""
    return frozenset(p.name for p in joint.parameters)


def pack_seeds(
    plant: Plant, blocks: Blocks, *, links: Sequence[tuple[int, ...]] = (),
    delays: Sequence[tuple[int, ...]] = (), pushes: Sequence[tuple[int, ...]] = (), pushed: FloatArray | None = None,
) -> Seeds:  # fmt: skip
    """Return the derivatives of a plant's numbers as `kernels.variation` takes them.

    Args:
        plant: whose numbers they are.
        blocks: column of a parameter, row of `Seeds.begin`, and the derivatives, (bands, numbers).
        links: see `Seeds`, as what follows.
        delays: the same.
        pushes: the same.
        pushed: the same.
    """
    found = sorted(
        (row, int(band), int(number), column, float(block[band, number]))
        for column, row, block in blocks
        for band, number in np.argwhere(block)
    )
    rows = len(plant.masses) + len(plant.pairs) + len(plant.places)
    bands = max(plant.masses.shape[1], plant.springs.shape[1])
    keys = [row * bands + band for row, band, *_ in found]
    begin = np.searchsorted(keys, bands * np.arange(rows)[:, np.newaxis] + np.arange(bands + 1))
    numbers, columns = (np.array([one[i] for one in found], dtype=np.int64) for i in (2, 3))
    of_links, of_delays, of_pushes = (
        np.array(one, dtype=np.int64).reshape(-1, width) for one, width in ((links, 3), (delays, 2), (pushes, 2))
    )
    values, none = np.array([one[4] for one in found]), np.zeros((0, 0))
    return Seeds(begin, numbers, columns, values, of_links, of_delays, of_pushes, none if pushed is None else pushed)


def slope(moved: AnyArray) -> FloatArray:
    """Return the derivatives of numbers after a complex step."""
    return np.asarray(np.imag(moved) / IMAGINARY)
