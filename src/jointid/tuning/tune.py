"""Tune a drive from an estimate: margins, gains, notch and feed-forward."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from jointid.common.arrays import FloatArray
from jointid.common.charts import LEVEL, MEASURED, SIMULATED, panels, styled
from jointid.common.document import Block, Document, Documented, Facts, Table, Text, common_facts
from jointid.common.errors import MethodError
from jointid.common.messages import Progress, ignore_progress
from jointid.common.parallel import one_thread
from jointid.common.settings import settings_of
from jointid.common.text import in_words, join, number
from jointid.common.transmission import Transmission
from jointid.estimation.result.estimate import Estimate
from jointid.estimation.result.verdict import Subject
from jointid.models.controllers import PD, Cascade, Controller, Notch, ServoController
from jointid.models.joints import FlexibleJoint
from jointid.models.linear import ComplexArray
from jointid.tuning.margins import Interval, Margins, crossover, possible_joints
from jointid.tuning.proposals import Gain, Layout, StiffestLoop, Tuning, list_feedforward, list_gains, lumped_parameters

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_SMALLEST = 1e-3  # loop gain that is shown


@dataclass(frozen=True, slots=True, eq=False)
class LoopMargins:
    """A loop and its margins.

    Attributes:
        controller: its law. estimate: margins at the estimate. worst: each the smallest over the interval.
        crossover: Hz, the highest frequency at which the loop's gain is 1, over the interval.
        hertz, response: (frequencies,) of the loop cut open at the torque, at the estimate.
    """

    controller: Controller
    estimate: Margins
    worst: Margins
    crossover: float
    hertz: FloatArray
    response: ComplexArray


@dataclass(frozen=True, slots=True, eq=False)
class Tuned(Documented):
    """Margins over an estimate's interval, and proposed gains.

    Attributes:
        record: its name. model: "rigid" or "flexible". transmission: on whose `side` the joint is.
        settings: of the call. interval: joints of the worst case, in a sentence.
        present: the present loop. proposed: with other gains; None if no proposal is possible.
        gains: proposed. notch: proposed with them, if any.
        feedforward: of the reference.
        notes: remarks, a sentence each.
        doubts: failed checks of the fit and the loop, a clause each.
    """

    record: str
    model: str
    transmission: Transmission | None
    settings: Tuning
    interval: str
    present: LoopMargins
    proposed: LoopMargins | None
    gains: tuple[Gain, ...]
    notch: Notch | None
    feedforward: tuple[Gain, ...]
    notes: tuple[str, ...]
    doubts: tuple[str, ...] = ()

    @property
    def sentence(self) -> str:
        """Sentence: gains to set, and the margin nearest to its requirement."""
        present, asked = self.present.worst, self.settings
        gains = [f"{in_words(g.key)} from {number(g.before, 4)} to {number(g.after, 4)} {g.unit}" for g in self.gains]
        gains += [f"a notch at {number(self.notch.frequency, 3)} Hz"] if self.notch is not None else []
        beware = f"Beware: {join(self.doubts)}. " if self.doubts else ""
        advice = f"{beware}Set {join(gains)}" if gains else f"{beware}No gains are proposed"
        if not present.stable:
            return f"{advice}: in the worst case of the estimate's interval the present loop is not stable."
        required = {"gain": asked.gain_margin, "phase": math.radians(asked.phase_margin), "modulus": asked.modulus}
        name = min(required, key=lambda one: getattr(present, one) / required[one])
        unit, degree = (" degrees", math.degrees(1.0)) if name == "phase" else ("", 1.0)
        margin, least = (number(degree * one, 3) for one in (getattr(present, name), required[name]))
        after = self.proposed and number(degree * getattr(self.proposed.worst, name), 3)
        moved = f"goes from {margin} to {after}" if after else f"is {margin}"
        return f"{advice}: in the worst case the {name} margin {moved}{unit} ({least} required)."

    def to_document(self, *, details: bool = False) -> Document:
        """Tables before and after, with notes."""
        del details
        joint, worst = ("joint", f"{self.model}, of {self.record}"), ("worst case over", self.interval)
        blocks: list[Block] = [Facts((joint, worst, *common_facts(None, self.transmission))), *self.proposal()]
        blocks.append(_tabulate("feed-forward", self.feedforward))
        return Document(self.sentence, (*blocks, Facts(tuple(("note", note) for note in self.notes))))

    def proposal(self) -> tuple[Block, ...]:
        """Present and proposed margins, gains and notch."""
        blocks: list[Block] = [self._tabulate_margins(), *([_tabulate("gain", self.gains)] if self.gains else [])]
        if (notch := self.notch) is not None:
            sizes = number(notch.frequency, 4), number(notch.bandwidth, 4), number(notch.depth, 2)
            blocks.append(Text("notch of the torque: {} Hz, {} Hz wide, {} left at its centre".format(*sizes)))
        return tuple(blocks)

    @styled
    def plot(self) -> Figure:
        """Draw the open loops at the estimate."""
        figure, (gain, phase) = panels([325] * 2, title=f"{self.record}: the {self.model} joint")
        loops = [("as it is", self.present, MEASURED)]
        loops += [("proposed", self.proposed, SIMULATED)] if self.proposed is not None else []
        for name, loop, colour in loops:
            gain.plot(loop.hertz, np.abs(loop.response), color=colour, label=name)
            phase.plot(loop.hertz, np.degrees(np.unwrap(np.angle(loop.response))), color=colour)
        gain.axhline(1.0, **LEVEL)
        gain.set(xlabel="frequency [Hz]", ylabel="loop gain [1]", xscale="log", yscale="log")
        gain.set_ylim(_SMALLEST, 2 * max(float(np.abs(loop.response).max()) for _, loop, _ in loops))
        phase.axhline(-180.0, **LEVEL)
        phase.set(xlabel="frequency [Hz]", ylabel="loop phase [degrees]", xscale="log")
        return figure

    def _tabulate_margins(self) -> Table:
        header = ("margins", "gain", "reduction", "phase deg", "delay ms", "distance from -1", "crossover Hz")
        rows = []
        for name, loop in (("as it is", self.present), ("proposed", self.proposed)):
            if loop is not None:
                rows.append((f"{name}, at the estimate", *_write_margins(loop.estimate), "-"))
                rows.append((f"{name}, worst case", *_write_margins(loop.worst), number(loop.crossover, 3)))
        asked = self.settings.asked
        rows.append(("required", *_write_margins(Margins(*asked))[:3], "-", number(asked[-1], 3), "-"))
        return Table(header, tuple(rows))


def _write_margins(margins: Margins) -> tuple[str, ...]:
    """Return gain, reduction, phase, delay and distance."""
    if not margins.stable:
        return ("not stable", *("-",) * 4)
    sizes = margins.gain, margins.reduction, math.degrees(margins.phase), 1e3 * margins.delay, margins.modulus
    return tuple("any" if math.isinf(size) else number(size, 3) for size in sizes)


def _tabulate(title: str, gains: tuple[Gain, ...]) -> Table:
    """Return gains or feed-forwards as a table."""
    rows = []
    for one in gains:
        spread = "-" if one.std is None else number(2 * one.std, 2)
        rows.append((one.key, number(one.before), number(one.after), spread, one.unit, one.formula))
    return Table((title, "now", "proposed", "2 sigma", "unit", "formula"), tuple(rows), words=(0, 4, 5))


_NONE = "only of a cascade, a PD or a PID gains are proposed, if some keep the margins for all joints: ask for less"


@one_thread
def tune(estimate: Estimate, *, progress: Progress = ignore_progress, **asked: Any) -> Tuned:
    """Compute the margins of an estimate's loop, and propose settings.

    Args:
        estimate: with the loop, its deviations and correlations: by DIDIM with least squares, rigid or flexible.
        progress: receives messages.
        asked: what the proposed loop keeps in the worst case: `gain_margin`, a ratio, `phase_margin` in degrees, and
            `modulus`, the distance from -1, for joints within the interval of `confidence`; `notch`, whether one may be
            proposed; `seed`.

    Returns:
        Margins of the present and the proposed loop, nominal and worst case; gains of the same structure, a notch where
        the mode limits them, and feed-forward.

    Raises:
        MethodError: the estimate has no controller, no deviations, a refused stiffness, or a nonlinear spring.

    Limits: the loop is linear, unsaturated and sliding; Coulomb friction also holds a joint at rest. Gravity that
    turns with the link, further modes, and images in multirate loops are not in the margins; stability includes the
    latter.
    """
    known = [one.name for one in settings_of(Tuning)]
    if unknown := sorted(asked.keys() - known):
        raise MethodError(f"Tuning has no setting {join(unknown)}; expected {join(known)}: correct the name.")
    settings, joint = Tuning(**asked), estimate.settings.joint
    if any(row.name == "stiffness" and row.value is None for row in estimate.rows):
        raise MethodError(
            f"The stiffness is refused, and margins need the joint's mode: {estimate.data.record} does not show it. "
            "Record stronger ramps or pulses on the torque, or identify the joint as rigid."
        )
    joint.require_linear("Tuning takes", spring_alone=True)
    controller = None if estimate.settings.loop is None else estimate.settings.loop.controller
    if not isinstance(controller, ServoController):
        raise MethodError(
            f"Margins are of a loop under a law of the package, and that of {estimate.data.record} is not known; add "
            "[controller] to the joint file, or learn it with jointid learn-controller, and identify by DIDIM."
        )
    interval = possible_joints(estimate, settings.confidence)
    progress("tuning the loop")
    present = _evaluate(estimate, interval, controller, settings)
    layout = _propose(estimate, interval, controller, settings)
    doubted = (c.words for name in (Subject.FIT, Subject.LOOP) for c in estimate.about(name) if c.passed is False)
    return Tuned(
        record=estimate.data.record,
        model=joint.model,
        transmission=joint.transmission,
        settings=settings,
        interval=interval.description,
        present=present,
        proposed=None if layout is None else _evaluate(estimate, interval, layout.controller, settings),
        gains=() if layout is None else list_gains(estimate, controller, layout),
        notch=None if layout is None else layout.notch,
        feedforward=list_feedforward(estimate, controller),
        notes=(*(() if layout else (_NONE,)), *_take_notes(estimate, present)),
        doubts=tuple(doubted),
    )


def _evaluate(estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning) -> LoopMargins:
    """Return the margins of a loop at the estimate, and the worst."""
    law = controller.law(estimate.data.sample_time)
    joints = interval.sample(settings.seed + 1, law)  # others than those for which the gains were chosen
    margins, response = joints.margins(law), joints.response(law)
    at, worst = Margins(*margins[0].tolist()), Margins(*np.min(margins, axis=0).tolist())
    return LoopMargins(controller, at, worst, crossover(response, joints.hertz), joints.hertz, response[0])


def _propose(estimate: Estimate, interval: Interval, controller: Controller, settings: Tuning) -> Layout | None:
    """Stiffest cascade, PD or PID that keeps the margins; None if none."""
    if not isinstance(controller, Cascade | PD):
        return None
    _, inertia, _ = lumped_parameters(estimate)["inertia"]
    sample_time, flexible = estimate.data.sample_time, estimate.settings.joint.model == "flexible"
    band, mode = None if flexible else estimate.settings.filtering.cutoff, None
    if flexible and interval.names and settings.notch:
        mode = FlexibleJoint.frequencies(interval.nominal)["free_free"]
    joints = interval.sample(settings.seed, controller.law(sample_time))
    return StiffestLoop(joints, inertia, sample_time, settings, band).find(controller, mode)


def _take_notes(estimate: Estimate, present: LoopMargins) -> list[str]:
    joint = estimate.settings.joint
    left_out = {
        "the modes of a joint that is taken as rigid": joint.model == "rigid",
        "gravity that turns with the link": joint.gravity is not None and joint.gravity.turns,
        "the ripple": joint.ripple is not None,
        joint.friction.adds or "friction towards standstill": not joint.friction.linear,
        "images of the slower of two rates": present.controller.law(estimate.data.sample_time).phases > 1,
    }
    missing = [what for what, is_there in left_out.items() if is_there]
    rate = ["the counterbalance's rate"] * (joint.gravity is not None and joint.gravity.counterbalance.rate != 0.0)
    said = {"margins and feed-forward leave out": missing, "feed-forward leaves out": rate}
    return [f"{words} {join(what)}" for words, what in said.items() if what]
