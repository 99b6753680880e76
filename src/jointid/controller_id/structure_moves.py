"""Moves between structures: neighbours, removal of parts, canonical names."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from jointid.controller_id.structures import (
    AVERAGED,
    CONSTANT,
    FEEDFORWARDS,
    FIELDS,
    INTERPOLATIONS,
    LATE,
    MEANS,
    RATES,
    SLOWER,
    TORQUE_FILTERS,
    VELOCITY,
    VELOCITY_FILTERS,
    Law,
    Structure,
)


def remove_part(structure: Structure, name: str) -> Structure:
    """Remove the part to which a number belongs."""
    if name == "integral_gain":
        # A PD without the reference's velocity is a P-P.
        cascade = structure.cascade or structure.reference_velocity == "none"
        return replace(structure, law="P-P" if cascade else "PD", **_proportional(structure, cascade))
    if name == "velocity_feedforward":
        return replace(structure, reference_velocity="none")
    if name == "reference_delay":
        return replace(structure, reference_delay=False)
    if name.startswith("torque_filters"):
        return replace(structure, torque_filter="none")
    part = next(part for part, field in FIELDS.items() if field == name)
    return replace(structure, feedforward=structure.feedforward - {part})


def _proportional(structure: Structure, cascade: bool) -> dict[str, Any]:
    """Velocity feed-forward under its name without the integral."""
    if cascade and not structure.cascade and VELOCITY in structure.feedforward:
        return {"reference_velocity": "share", "feedforward": structure.feedforward - {VELOCITY}}
    return {}


def canonical(structure: Structure) -> Structure:
    """Canonical name of a law: the cascade's if a PD or PID is equivalent."""
    if structure.cascade:
        return structure
    if structure.reference_velocity == "difference" and structure.velocity_filter == "none":
        beside = structure.feedforward - {VELOCITY}
        law: Law = "P-PI" if structure.integrates else "P-P"
        return replace(structure, law=law, reference_velocity="full", feedforward=beside)
    if structure.law == "PD" and structure.reference_velocity == "none":
        return replace(structure, law="P-P", **_proportional(structure, True))
    return structure


def list_simpler(structure: Structure) -> Iterator[Structure]:
    """Yield the structures with one part fewer, each under its canonical name."""
    for part in structure.feedforward:
        yield canonical(replace(structure, feedforward=structure.feedforward - {part}))
    if structure.integrates:
        yield canonical(remove_part(structure, "integral_gain"))
    if structure.cascade and structure.reference_velocity in ("share", "channel"):
        yield replace(structure, reference_velocity="none")
    if structure.cascade and structure.reference_velocity == "share":
        yield replace(structure, reference_velocity="full")
    if structure.torque_filter != "none":
        yield replace(structure, torque_filter="none")
    if structure.velocity_filter != "none":
        yield canonical(replace(structure, velocity_filter="none"))
    if structure.reference_delay:
        yield replace(structure, reference_delay=False)
    if structure.average:
        yield replace(structure, average=0)


def list_neighbours(structure: Structure, channel: bool) -> Iterator[Structure]:
    """Yield canonical structures that differ in one part."""
    seen = {structure}
    for one in map(canonical, _changes(structure, channel)):
        if one not in seen:
            seen.add(one)
            yield one


def list_laws(frame: Structure, channel: bool) -> Iterator[Structure]:
    """Yield all canonical laws of a frame, with all feed-forwards."""
    seen = set[Structure]()
    for law in _other_laws(replace(frame, feedforward=frozenset(FEEDFORWARDS)), channel):
        for one in (law, replace(law, reference_delay=True)):
            known = canonical(one)
            if known.frame == frame and known not in seen:
                seen.add(known)
                yield known


def _changes(structure: Structure, channel: bool) -> Iterator[Structure]:
    yield from _other_laws(structure, channel)
    yield from (replace(structure, velocity_filter=one) for one in VELOCITY_FILTERS)
    for part in FEEDFORWARDS:
        allowed = not (part == CONSTANT and structure.integrates)
        allowed &= not (part == VELOCITY and structure.law == "P-P" and structure.reference_velocity != "channel")
        if part in structure.feedforward or allowed:
            yield replace(structure, feedforward=structure.feedforward ^ {part})
    yield from (replace(structure, torque_filter=one) for one in TORQUE_FILTERS)
    yield from _move_filter(structure)
    yield replace(structure, reference_delay=not structure.reference_delay)
    if structure.reference_delay or structure.average:  # a mean is late, too
        near = (structure.average - 1, structure.average + 1) if structure.average else ()
        yield from (replace(structure, average=n, reference_delay=False) for n in (*AVERAGED, *near) if n > 1)
    yield from _other_rates(structure)
    yield from (replace(structure, late=n) for n in (0, *LATE))


def _move_filter(structure: Structure) -> Iterator[Structure]:
    """Move the filter to the other place; for a PD it may be equivalent."""
    velocity, torque = structure.velocity_filter, structure.torque_filter
    if torque in ("first order", "second order") and velocity == "none":
        yield replace(structure, velocity_filter=torque, torque_filter="none")
        if structure.reference_velocity == "full":
            law: Law = "PID" if structure.integrates else "PD"
            like = replace(structure, law=law, reference_velocity="difference", every=1, offset=0)
            yield replace(like, velocity_filter=torque, torque_filter="none")
    if velocity in ("first order", "second order") and torque == "none":
        yield replace(structure, velocity_filter="none", torque_filter=velocity)


def _other_rates(structure: Structure) -> Iterator[Structure]:
    """Yield the law at other rates with equal averaging time, or position-loop rates.

    The position loop of a law faster than the log runs at its rate or the log's.
    """
    for rate in (1, *RATES):
        slower = rate if structure.every > 1 else 1
        mean = _mean_over_same_time(structure.velocity_filter, rate / structure.rate)
        for way in INTERPOLATIONS if rate > 1 else INTERPOLATIONS[:1]:
            for filtered in {structure.velocity_filter, mean}:
                yield replace(structure, rate=rate, interpolation=way, every=slower, offset=0, velocity_filter=filtered)
    if not structure.cascade:
        return
    pairs = [(structure.rate, 0)] if structure.rate > 1 else [(n, k) for n in SLOWER for k in range(n)]
    yield from (replace(structure, every=every, offset=offset) for every, offset in [(1, 0), *pairs])


def _mean_over_same_time(velocity_filter: str, periods: float) -> str:
    """Convert a mean to another rate, over the same time."""
    if velocity_filter != "none" and not velocity_filter.startswith("mean "):
        return velocity_filter
    samples = (1 if velocity_filter == "none" else int(velocity_filter.split()[1])) * periods
    if samples == 1:
        return "none"
    return f"mean {samples:.0f}" if samples in MEANS else velocity_filter


def _other_laws(structure: Structure, channel: bool) -> Iterator[Structure]:
    law: Law
    cascades = ("none", "share", "full", *(["channel"] if channel else []))
    others = ("difference", *(["channel"] if channel else []))
    for integral in (False, True):
        parts = structure.feedforward - ({CONSTANT} if integral else set())
        for velocity in cascades:
            law = "P-PI" if integral else "P-P"
            if integral or velocity == "channel":
                yield replace(structure, law=law, reference_velocity=velocity, feedforward=parts)
            if velocity != "channel":  # the cascade has its own
                beside = parts - {VELOCITY}
                yield replace(structure, law=law, reference_velocity=velocity, feedforward=beside)
        # A PD without the reference's velocity is a P-P; without a filter, one with its difference is one, too.
        kinds = [kind for kind in others if kind != "difference" or structure.velocity_filter != "none"]
        law = "PID" if integral else "PD"
        for velocity in [*kinds, *(["none"] if integral else [])]:
            yield replace(structure, law=law, reference_velocity=velocity, feedforward=parts, every=1, offset=0)
