"""What every method writes alike in an estimate: the rows of its parameters, its record, and what it warns of."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from jointid.common.arrays import FloatArray
from jointid.estimation.result.estimate import Data, fingerprint
from jointid.estimation.result.params import EstimatedParameter
from jointid.models.parameters import Parameter, Quantity
from jointid.records.record import Record
from jointid.simulation.loop_input import ClosedLoop
from jointid.solvers.solve import Bounds

NOT_CONVERGED = "the search did not converge; the values are where it stopped"

_PHYSICAL = (Quantity.INERTIA, Quantity.STIFFNESS)  # what no joint has none of
_AT_LIMIT = 0.01  # of the periods: more is said
_INSEPARABLE = 0.95  # a correlation that says two parameters are known only together


def build_rows(
    parameters: Iterable[Parameter],
    values: Mapping[str, float],
    std: Mapping[str, float],
    unit: Callable[[Parameter], str],
    of_joint: Collection[str],
    lost: Collection[str] = (),
) -> tuple[EstimatedParameter, ...]:
    """Return the table of an estimate.

    Args:
        parameters: in its order.
        values: of all of them, by name.
        std: standard deviations of the free ones, by name.
        unit: of a parameter.
        of_joint: names of those that belong to the joint, and not to what surrounds it.
        lost: names of free ones that the record does not determine.
    """
    return tuple(
        EstimatedParameter(
            p.name,
            p.symbol,
            unit(p),
            values[p.name],
            std.get(p.name),
            p.free,
            p.free and p.name not in lost,
            of_joint=p.name in of_joint,
        )
        for p in parameters
    )


def build_data(record: Record, channels: tuple[str, ...], sample_time: float) -> Data:
    """Return what an estimate says of the one record that it was identified from."""
    assert record.torque is not None
    return Data(
        channels=channels,
        record=record.name,
        sample_time=sample_time,
        torque_unit=record.torque.unit,
        fingerprint=fingerprint(record.torque.values),
    )


def list_loop_channels(loop: ClosedLoop, record: Record) -> tuple[str, ...]:
    """Return the channels of a record that a simulation of its loop reads."""
    return (*loop.channels, *(("injected",) if record.injected is not None else ()))


def holds_zero(p: Parameter, value: float, std: float) -> bool:
    """True if the interval of an inertia or a stiffness holds 0, which no joint has."""
    return p.quantity in _PHYSICAL and value <= 2 * std


def find_at_bound(free: Sequence[Parameter], x: FloatArray, near: FloatArray | None = None) -> tuple[str, ...]:
    """Return the names of the free parameters that a bound holds, within `near` of it."""
    held = Bounds.of(free).reached(x) if near is None else Bounds.of(free).reached(x, near)
    return tuple(p.name for p, at in zip(free, held, strict=True) if at)


def warn_of_bounds(names: Iterable[str], records: str = "record") -> list[str]:
    """Return a sentence on each parameter that a bound holds."""
    return [f"{name} is at its bound, where it does not follow the {records}" for name in names]


def warn_of_limit(share: float) -> list[str]:
    """Return a sentence on a controller that was at its limit in more than a few of its periods."""
    if share <= _AT_LIMIT:
        return []
    return [
        f"the controller is at its limit in {100 * share:.1f} % of the periods, where the torque says nothing of the "
        "joint"
    ]


def warn_of_inseparable(
    names: Sequence[str], correlation: FloatArray, told: Iterable[int], records: str = "this record"
) -> list[str]:
    """Return a sentence on each two parameters that are known only together.

    Args:
        names: of the free parameters.
        correlation: of their errors.
        told: which of them are of interest.
        records: what does not tell them apart.
    """
    of_interest = list(told)
    return [
        f"{names[i]} and {names[j]} are hard to tell apart in {records} (correlation {correlation[i, j]:+.3f})"
        for i in of_interest
        for j in of_interest
        if j < i and abs(correlation[i, j]) > _INSEPARABLE
    ]
