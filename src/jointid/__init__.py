"""Identify a servo-driven joint from motor torque and the commanded reference alone.

Every public name is here, loaded when it is first used: importing the package imports nothing heavy.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from jointid.answers import (
        advice_answer,
        comparison_answer,
        estimate_answer,
        loop_answer,
        revealing_answer,
        simulation_answer,
        together_answer,
        validation_answer,
    )
    from jointid.assessment.advice import Advice, advise
    from jointid.assessment.comparison import Comparison, compare
    from jointid.assessment.intervals import Intervals, intervals
    from jointid.assessment.loop import check_loop
    from jointid.assessment.loopcheck import LoopCheck
    from jointid.assessment.revealing import Revealing, revealing, what_would_tell_more
    from jointid.assessment.suspects import LoopTests
    from jointid.assessment.validation import Validation, validate
    from jointid.common.errors import (
        ExtraError,
        JointFileError,
        JointidError,
        MethodError,
        RecordError,
    )
    from jointid.data.checks import check_record
    from jointid.data.columns import Column
    from jointid.data.excitation import pulses, trapezoids
    from jointid.data.reading import read, write
    from jointid.data.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, record_of
    from jointid.data.signals import Filtering
    from jointid.estimation.didim import DIDIM
    from jointid.estimation.drive_side import DriveSideFit
    from jointid.estimation.estimate import Estimate, EstimatedParameter, IdentifiedJoint
    from jointid.estimation.flexible import FlexibleDIDIM
    from jointid.estimation.identify import identify
    from jointid.estimation.idim import IDIM
    from jointid.estimation.open_loop import OpenLoopFit
    from jointid.jointfile import JointFile, load
    from jointid.model.controllers import PD, Cascade, DigitalFilter, StateSpaceController
    from jointid.model.effects import Drift, PositionHarmonics
    from jointid.model.friction import AsymmetricFriction, SymmetricFriction
    from jointid.model.joints import FlexibleJoint, RigidJoint, frequencies, rigid_sums
    from jointid.model.parameters import Parameter
    from jointid.paper.twin import Twin, twin
    from jointid.report.figures import residual_figure, save, torque_figure
    from jointid.simulation.closed_loop import Initial, Outcome, Simulation, simulate, simulate_many
    from jointid.simulation.drive_side import DriveSide
    from jointid.simulation.experiment import ClosedLoop, prepare
    from jointid.simulation.open_loop import OpenLoop
    from jointid.simulation.synthesis import simulated_record
    from jointid.together.common_estimate import CommonEstimate, RecordShare
    from jointid.together.together import identify_together

_HOMES = {
    "answers": (
        "advice_answer",
        "comparison_answer",
        "estimate_answer",
        "loop_answer",
        "revealing_answer",
        "simulation_answer",
        "together_answer",
        "validation_answer",
    ),
    "assessment.advice": ("Advice", "advise"),
    "assessment.comparison": ("Comparison", "compare"),
    "assessment.intervals": ("Intervals", "intervals"),
    "assessment.loop": ("check_loop",),
    "assessment.revealing": ("Revealing", "revealing", "what_would_tell_more"),
    "assessment.validation": ("Validation", "validate"),
    "common.errors": ("ExtraError", "JointFileError", "JointidError", "MethodError", "RecordError"),
    "data.checks": ("check_record",),
    "data.columns": ("Column",),
    "data.excitation": ("pulses", "trapezoids"),
    "data.reading": ("read", "write"),
    "data.record": ("Channel", "Injection", "InjectionPoint", "Record", "Tap", "Timing", "record_of"),
    "data.signals": ("Filtering",),
    "together.common_estimate": ("CommonEstimate", "RecordShare"),
    "estimation.didim": ("DIDIM",),
    "estimation.drive_side": ("DriveSideFit",),
    "estimation.estimate": ("Estimate", "EstimatedParameter", "IdentifiedJoint"),
    "estimation.flexible": ("FlexibleDIDIM",),
    "estimation.idim": ("IDIM",),
    "estimation.identify": ("identify",),
    "estimation.open_loop": ("OpenLoopFit",),
    "together.together": ("identify_together",),
    "assessment.loopcheck": ("LoopCheck",),
    "assessment.suspects": ("LoopTests",),
    "jointfile": ("JointFile", "load"),
    "model.controllers": ("PD", "Cascade", "DigitalFilter", "StateSpaceController"),
    "model.effects": ("Drift", "PositionHarmonics"),
    "model.friction": ("AsymmetricFriction", "SymmetricFriction"),
    "model.joints": ("FlexibleJoint", "RigidJoint", "frequencies", "rigid_sums"),
    "model.parameters": ("Parameter",),
    "paper.twin": ("Twin", "twin"),
    "report.figures": ("residual_figure", "save", "torque_figure"),
    "simulation.closed_loop": ("Initial", "Outcome", "Simulation", "simulate", "simulate_many"),
    "simulation.drive_side": ("DriveSide",),
    "simulation.experiment": ("ClosedLoop", "prepare"),
    "simulation.open_loop": ("OpenLoop",),
    "simulation.synthesis": ("simulated_record",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__version__ = "0.1.0"
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "Advice",
    "AsymmetricFriction",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "CommonEstimate",
    "Comparison",
    "DigitalFilter",
    "Drift",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "EstimatedParameter",
    "ExtraError",
    "Filtering",
    "FlexibleDIDIM",
    "FlexibleJoint",
    "IdentifiedJoint",
    "Initial",
    "Injection",
    "InjectionPoint",
    "Intervals",
    "JointFile",
    "JointFileError",
    "JointidError",
    "LoopCheck",
    "LoopTests",
    "MethodError",
    "OpenLoop",
    "OpenLoopFit",
    "Outcome",
    "Parameter",
    "PositionHarmonics",
    "Record",
    "RecordError",
    "RecordShare",
    "Revealing",
    "RigidJoint",
    "Simulation",
    "StateSpaceController",
    "SymmetricFriction",
    "Tap",
    "Timing",
    "Twin",
    "Validation",
    "advice_answer",
    "advise",
    "check_loop",
    "check_record",
    "compare",
    "comparison_answer",
    "estimate_answer",
    "frequencies",
    "identify",
    "identify_together",
    "intervals",
    "load",
    "loop_answer",
    "prepare",
    "pulses",
    "read",
    "record_of",
    "residual_figure",
    "revealing",
    "revealing_answer",
    "rigid_sums",
    "save",
    "simulate",
    "simulate_many",
    "simulated_record",
    "simulation_answer",
    "together_answer",
    "torque_figure",
    "trapezoids",
    "twin",
    "validate",
    "validation_answer",
    "what_would_tell_more",
    "write",
]


def __getattr__(name: str) -> Any:
    """Load a public name from the room it lives in."""
    if name not in _HOME:
        raise AttributeError(f"module 'jointid' has no attribute {name!r}")
    return getattr(import_module(f"jointid.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted([*__all__, "__version__"])
