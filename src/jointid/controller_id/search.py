"""Search for a controller's structure by single changes, by Schwarz's criterion.

A stretch of the record gives the candidates, the whole record judges them.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from jointid.common.messages import Detail, Progress, follow, ignore_progress
from jointid.controller_id.fitting import FittedLaw, Fitter
from jointid.controller_id.loop_record import LoopRecord
from jointid.controller_id.noise import Noise
from jointid.controller_id.structures import ACCELERATION, COULOMB, Structure, list_frames, list_laws

ALIKE = 10.0  # of the criterion: a smaller difference does not distinguish two laws
MATERIAL = 1e-3  # of the torque's rms: a part that carries less is none
_SEGMENT = 4000  # samples that a search looks at
_BEST = 4  # laws of which all single changes are tried
_JUDGED = 12  # laws that the whole record judges
_ROUNDS = 24  # of such changes: what goes on longer leads to no law
_SCREENING, _FITTING = 3, 8  # evaluations in the search for a law's filters, when it is tried and when it is likely


@dataclass(frozen=True, slots=True, eq=False)
class Rival:
    """A structure compared with the best.

    Attributes:
        fitted: with the best-fitting numbers.
        worse: increase of the criterion over the best.
        apart: rms difference of the two predicted torques, as a share of the torque's rms.
    """

    in_json = "structure -fitted"
    fitted: FittedLaw
    worse: float
    apart: float

    @property
    def structure(self) -> Structure:
        """Its structure."""
        return self.fitted.structure


def search(log: LoopRecord, progress: Progress = ignore_progress) -> tuple[Fitter, FittedLaw, list[Rival]]:
    """Return the fitter of the record, the likeliest law and sorted rivals."""
    progress(f"learning the controller from {log.samples} samples")
    channel = log.record.reference_velocity is not None
    stretch, laws = Fitter(log.select_strongest(_SEGMENT)), dict[Structure, FittedLaw]()
    for _ in range(2):  # under the same noise at all frequencies, then under that of the best
        laws = {}
        for structure in _first_structures():
            _try(stretch, laws, structure, {}, stretch.shared, channel)
        best = _best_of(laws, stretch.shared)
        stretch.share(best)
    done = set[Structure]()
    while True:
        if (new := _best_of(laws, best.noise)) is not best:
            best = new
            stretch.share(best)
        order = _sort(laws, best.noise)
        likely = next((one for one in order[:_BEST] if one.structure not in done), None)
        if likely is None or len(done) == _ROUNDS:
            return _judge(Fitter(log), order[:_JUDGED], channel, progress)
        progress(Detail(f"{likely.structure}: {len(likely.structure.names)} numbers"))
        done.add(likely.structure)
        likely = stretch.fit(likely.structure, likely.numbers, best.noise, _FITTING) or likely
        _keep(laws, likely, best.noise)
        for structure in list_laws(likely.structure, channel):
            _keep(laws, stretch.fit(structure, likely.numbers, best.noise, 0), best.noise)
        for structure in list_frames(likely.structure):
            _try(stretch, laws, structure, likely.numbers, best.noise, channel)


def simplest(best: FittedLaw, rivals: Iterable[Rival]) -> FittedLaw:
    """Simplest law that is as good as the best one.

    It has the same filters and the same torque, within `MATERIAL`, since direction-dependent encoder errors can be
    significant. Or the record does not distinguish it, and it has at most half the parts: hidden by quantisation, a
    filter's noise spectrum is inexact, which a complex law can fit.
    """
    own = best.structure
    good = (
        rival.fitted
        for rival in rivals
        if _is_same(rival, best) or (rival.worse < ALIKE and 2 * rival.structure.parts <= own.parts)
    )
    found = min(good, key=lambda one: one.structure.parts, default=best)
    return found if found.structure.parts < own.parts else best


def _judge(
    fitter: Fitter, likely: list[FittedLaw], channel: bool, progress: Progress
) -> tuple[Fitter, FittedLaw, list[Rival]]:
    """Fit likely laws, and simplifications of the best, to the whole record."""
    laws, done = dict[Structure, FittedLaw](), set[Structure]()
    best = fitter.fit(likely[0].structure, likely[0].numbers, fitter.shared, _FITTING) or likely[0]
    fitter.share(best)
    tried = {one.structure: one.numbers for one in likely}
    while fresh := [structure for structure in tried if structure not in done]:
        for structure in follow(fresh, progress, "judging on the whole record", len(fresh), "laws"):
            _keep(laws, fitter.fit(structure, tried[structure], best.noise, _FITTING), best.noise)
        done.update(fresh)
        best = _best_of(laws, best.noise)
        fitter.share(best)
        chosen = simplest(best, _compare(fitter, best, laws))
        near = (*list_laws(chosen.structure, channel), *list_frames(chosen.structure))
        tried = {structure: chosen.numbers for structure in near if structure.parts < chosen.structure.parts}
    return fitter, chosen, _compare(fitter, chosen, laws)


def _first_structures() -> Iterator[Structure]:
    """Yield the initial structures: the richest, with each filter and clock."""
    parts = frozenset({ACCELERATION, COULOMB})
    for law, velocity in (("P-PI", "share"), ("PID", "difference")):
        rich = Structure(law, velocity, feedforward=parts)  # type: ignore[arg-type]
        yield from (replace(rich, velocity_filter=one) for one in ("none", "mean 2", "first order", "second order"))
        filtered = rich if rich.cascade else replace(rich, velocity_filter="first order")
        yield from (replace(filtered, torque_filter=one) for one in ("first order", "second order", "notch"))
        yield from (replace(filtered, rate=one) for one in (2, 4, 8))
        yield replace(filtered, reference_delay=True)
    yield from (replace(Structure("P-PI", "share", feedforward=parts), every=n) for n in (2, 4))


def _try(
    fitter: Fitter,
    laws: dict[Structure, FittedLaw],
    structure: Structure,
    known: Mapping[str, float],
    noise: Noise,
    channel: bool,
) -> None:
    """Fit a structure, then improve it by single changes of the law."""
    one, shared = fitter.fit(structure, known, noise, _SCREENING), fitter.shared
    while one is not None:
        _keep(laws, one, noise)
        near = (fitter.fit(like, one.numbers, shared, 0) for like in list_laws(one.structure, channel))
        best = min((law for law in near if law), key=lambda law: law.score(shared), default=one)
        one = best if best.score(shared) < one.score(shared) else None


def _keep(laws: dict[Structure, FittedLaw], one: FittedLaw | None, noise: Noise) -> None:
    """Keep the better fit of a structure."""
    held = None if one is None else laws.get(one.structure)
    if one is not None and (held is None or one.score(noise) < held.score(noise)):
        laws[one.structure] = one


def _best_of(laws: Mapping[Structure, FittedLaw], noise: Noise) -> FittedLaw:
    """Return the likeliest law under its own noise.

    If the choice cycles among laws, take the one with the least torque noise.
    """
    best, seen = _sort(laws, noise)[0], dict[Structure, FittedLaw]()
    while best.structure not in seen:
        seen[best.structure] = best
        best = _sort(laws, best.noise)[0]
    return min(seen.values(), key=lambda one: one.noise.torque)


def _sort(laws: Mapping[Structure, FittedLaw], noise: Noise) -> list[FittedLaw]:
    return sorted(laws.values(), key=lambda one: one.score(noise))


def _compare(fitter: Fitter, best: FittedLaw, laws: Mapping[Structure, FittedLaw]) -> list[Rival]:
    """Compare laws with the best, without equivalents that add inactive parts."""
    own, size, shown = best.score(best.noise), float(np.mean(fitter.log.torque**2)), fitter.predict(best)

    def apart(one: FittedLaw) -> float:
        return float(np.sqrt(np.mean(((fitter.predict(one) - shown) * fitter.kept) ** 2) / size))

    order = (one for one in _sort(laws, best.noise) if one is not best)
    rivals = (Rival(one, one.score(best.noise) - own, apart(one)) for one in order)
    most = best.structure.parts
    return [one for one in rivals if one.structure.parts <= most or not _is_same(one, best)]


def _is_same(rival: Rival, best: FittedLaw) -> bool:
    """Test for the same filters and the same torque."""
    own, other = best.structure, rival.structure
    alike = (own.velocity_filter, own.torque_filter) == (other.velocity_filter, other.torque_filter)
    return alike and rival.apart < MATERIAL
