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
        learned_answer,
        long_answer,
        loop_answer,
        revealing_answer,
        simulation_answer,
        together_answer,
        tuning_answer,
        validation_answer,
    )
    from jointid.assessment.advice import Advice, advise
    from jointid.assessment.comparison import Comparison, compare
    from jointid.assessment.detectable import Detectable, detectable
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
    from jointid.data.drive import Drive
    from jointid.data.excitation import pulses, trapezoids
    from jointid.data.pieces import Log
    from jointid.data.reading import read
    from jointid.data.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, record_of
    from jointid.data.signals import Filtering
    from jointid.data.transmission import Transmission
    from jointid.data.writing import write
    from jointid.estimation.didim import DIDIM
    from jointid.estimation.drive_side import DriveSideFit
    from jointid.estimation.estimate import Estimate, IdentifiedJoint
    from jointid.estimation.estimated import EstimatedParameter
    from jointid.estimation.flexible import FlexibleDIDIM
    from jointid.estimation.identify import identify
    from jointid.estimation.idim import IDIM
    from jointid.estimation.open_loop import OpenLoopFit
    from jointid.jointfile import JointFile, load
    from jointid.learning.learn import learn_loop
    from jointid.learning.learned import LearnedLoop
    from jointid.long.identify_long import identify_long
    from jointid.long.long_estimate import LongEstimate
    from jointid.model.controllers import (
        PD,
        PID,
        Cascade,
        DigitalFilter,
        FirstOrder,
        MovingAverage,
        Notch,
        SecondOrder,
        StateSpaceController,
    )
    from jointid.model.effects import Drift, PositionHarmonics
    from jointid.model.friction import AsymmetricFriction, SymmetricFriction
    from jointid.model.gravity import Counterbalance, Gravity
    from jointid.model.joints import FlexibleJoint, RigidJoint, frequencies, rigid_sums
    from jointid.model.parameters import Parameter
    from jointid.paper.twin import Twin, twin
    from jointid.report.figures import residual_figure, save, torque_figure
    from jointid.report.tuning_figure import tuning_figure
    from jointid.simulation.closed_loop import Initial, Outcome, Simulation, simulate, simulate_many
    from jointid.simulation.drive_side import DriveSide
    from jointid.simulation.experiment import ClosedLoop, prepare
    from jointid.simulation.open_loop import OpenLoop
    from jointid.simulation.synthesis import simulated_record
    from jointid.together.common_estimate import CommonEstimate, RecordShare
    from jointid.together.together import identify_together
    from jointid.tuning.plant import frequency_response
    from jointid.tuning.settings import Tuning
    from jointid.tuning.tune import tune
    from jointid.tuning.tuned import Tuned

_HOMES = {
    "answers": (
        "advice_answer",
        "comparison_answer",
        "estimate_answer",
        "learned_answer",
        "long_answer",
        "loop_answer",
        "revealing_answer",
        "simulation_answer",
        "together_answer",
        "tuning_answer",
        "validation_answer",
    ),
    "assessment.advice": ("Advice", "advise"),
    "assessment.comparison": ("Comparison", "compare"),
    "assessment.detectable": ("Detectable", "detectable"),
    "assessment.intervals": ("Intervals", "intervals"),
    "assessment.loop": ("check_loop",),
    "assessment.revealing": ("Revealing", "revealing", "what_would_tell_more"),
    "assessment.validation": ("Validation", "validate"),
    "common.errors": ("ExtraError", "JointFileError", "JointidError", "MethodError", "RecordError"),
    "data.checks": ("check_record",),
    "data.columns": ("Column",),
    "data.drive": ("Drive",),
    "data.excitation": ("pulses", "trapezoids"),
    "data.pieces": ("Log",),
    "data.reading": ("read",),
    "data.writing": ("write",),
    "data.record": ("Channel", "Injection", "InjectionPoint", "Record", "Tap", "Timing", "record_of"),
    "data.signals": ("Filtering",),
    "data.transmission": ("Transmission",),
    "together.common_estimate": ("CommonEstimate", "RecordShare"),
    "estimation.didim": ("DIDIM",),
    "estimation.drive_side": ("DriveSideFit",),
    "estimation.estimate": ("Estimate", "IdentifiedJoint"),
    "estimation.estimated": ("EstimatedParameter",),
    "estimation.flexible": ("FlexibleDIDIM",),
    "estimation.idim": ("IDIM",),
    "estimation.identify": ("identify",),
    "estimation.open_loop": ("OpenLoopFit",),
    "together.together": ("identify_together",),
    "assessment.loopcheck": ("LoopCheck",),
    "assessment.suspects": ("LoopTests",),
    "jointfile": ("JointFile", "load"),
    "learning.learn": ("learn_loop",),
    "learning.learned": ("LearnedLoop",),
    "model.controllers": (
        "PD",
        "PID",
        "Cascade",
        "DigitalFilter",
        "FirstOrder",
        "MovingAverage",
        "Notch",
        "SecondOrder",
        "StateSpaceController",
    ),
    "long.identify_long": ("identify_long",),
    "long.long_estimate": ("LongEstimate",),
    "model.effects": ("Drift", "PositionHarmonics"),
    "model.friction": ("AsymmetricFriction", "SymmetricFriction"),
    "model.gravity": ("Counterbalance", "Gravity"),
    "model.joints": ("FlexibleJoint", "RigidJoint", "frequencies", "rigid_sums"),
    "model.parameters": ("Parameter",),
    "paper.twin": ("Twin", "twin"),
    "report.figures": ("residual_figure", "save", "torque_figure"),
    "report.tuning_figure": ("tuning_figure",),
    "simulation.closed_loop": ("Initial", "Outcome", "Simulation", "simulate", "simulate_many"),
    "simulation.drive_side": ("DriveSide",),
    "simulation.experiment": ("ClosedLoop", "prepare"),
    "simulation.open_loop": ("OpenLoop",),
    "simulation.synthesis": ("simulated_record",),
    "tuning.plant": ("frequency_response",),
    "tuning.settings": ("Tuning",),
    "tuning.tune": ("tune",),
    "tuning.tuned": ("Tuned",),
}
_HOME = {name: module for module, names in _HOMES.items() for name in names}

__version__ = "0.1.0"
__all__ = [
    "DIDIM",
    "IDIM",
    "PD",
    "PID",
    "Advice",
    "AsymmetricFriction",
    "Cascade",
    "Channel",
    "ClosedLoop",
    "Column",
    "CommonEstimate",
    "Comparison",
    "Counterbalance",
    "Detectable",
    "DigitalFilter",
    "Drift",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "EstimatedParameter",
    "ExtraError",
    "Filtering",
    "FirstOrder",
    "FlexibleDIDIM",
    "FlexibleJoint",
    "Gravity",
    "IdentifiedJoint",
    "Initial",
    "Injection",
    "InjectionPoint",
    "Intervals",
    "JointFile",
    "JointFileError",
    "JointidError",
    "LearnedLoop",
    "Log",
    "LongEstimate",
    "LoopCheck",
    "LoopTests",
    "MethodError",
    "MovingAverage",
    "Notch",
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
    "SecondOrder",
    "Simulation",
    "StateSpaceController",
    "SymmetricFriction",
    "Tap",
    "Timing",
    "Transmission",
    "Tuned",
    "Tuning",
    "Twin",
    "Validation",
    "advice_answer",
    "advise",
    "check_loop",
    "check_record",
    "compare",
    "comparison_answer",
    "detectable",
    "estimate_answer",
    "frequencies",
    "frequency_response",
    "identify",
    "identify_long",
    "identify_together",
    "intervals",
    "learn_loop",
    "learned_answer",
    "load",
    "long_answer",
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
    "tune",
    "tuning_answer",
    "tuning_figure",
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
