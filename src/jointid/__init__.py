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
        drift_answer,
        estimate_answer,
        inspection_answer,
        learned_answer,
        long_answer,
        loop_answer,
        read_report,
        revealing_answer,
        simulation_answer,
        together_answer,
        tuning_answer,
        validation_answer,
    )
    from jointid.assessment.advice import Advice, advise
    from jointid.assessment.comparison import Comparison, compare
    from jointid.assessment.detectable import Detectable, detectable
    from jointid.assessment.dossier import Dossier, dossier
    from jointid.assessment.drift import ReportComparison, compare_reports
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
    from jointid.data.converting import Conversion, convert
    from jointid.data.drive import Drive
    from jointid.data.excitation import pulses, trapezoids
    from jointid.data.inspection import Inspection, inspect
    from jointid.data.pieces import Log
    from jointid.data.reading import read
    from jointid.data.record import Channel, Injection, InjectionPoint, Record, Tap, Timing, record_of
    from jointid.data.resampling import Resampling
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
    from jointid.exports.export import Export, export, read_estimated, state_space
    from jointid.exports.joint_toml import JointToml
    from jointid.exports.linear import Matlab, StateSpaceJson
    from jointid.exports.mjcf import Mjcf
    from jointid.exports.modelica import Modelica
    from jointid.exports.state_space import StateSpace
    from jointid.exports.urdf import Urdf
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
    from jointid.model.linear import frequency_response
    from jointid.model.parameters import Parameter
    from jointid.paper.twin import Twin, twin
    from jointid.report.channels import channels_figure
    from jointid.report.figures import residual_figure, save, torque_figure
    from jointid.report.report import Report, report_estimate, report_file
    from jointid.report.tuning_figure import tuning_figure
    from jointid.simulation.closed_loop import Initial, Outcome, Simulation, simulate, simulate_many
    from jointid.simulation.drive_side import DriveSide
    from jointid.simulation.experiment import ClosedLoop, prepare
    from jointid.simulation.open_loop import OpenLoop
    from jointid.simulation.synthesis import simulated_record
    from jointid.together.common_estimate import CommonEstimate, RecordShare
    from jointid.together.together import identify_together
    from jointid.tuning.settings import Tuning
    from jointid.tuning.tune import tune
    from jointid.tuning.tuned import Tuned

_HOMES = {
    "answers": (
        "advice_answer",
        "comparison_answer",
        "drift_answer",
        "estimate_answer",
        "inspection_answer",
        "learned_answer",
        "long_answer",
        "loop_answer",
        "read_report",
        "revealing_answer",
        "simulation_answer",
        "together_answer",
        "tuning_answer",
        "validation_answer",
    ),
    "assessment.advice": ("Advice", "advise"),
    "assessment.comparison": ("Comparison", "compare"),
    "assessment.detectable": ("Detectable", "detectable"),
    "assessment.dossier": ("Dossier", "dossier"),
    "assessment.drift": ("ReportComparison", "compare_reports"),
    "assessment.intervals": ("Intervals", "intervals"),
    "assessment.loop": ("check_loop",),
    "assessment.revealing": ("Revealing", "revealing", "what_would_tell_more"),
    "assessment.validation": ("Validation", "validate"),
    "common.errors": ("ExtraError", "JointFileError", "JointidError", "MethodError", "RecordError"),
    "data.checks": ("check_record",),
    "data.columns": ("Column",),
    "data.converting": ("Conversion", "convert"),
    "data.drive": ("Drive",),
    "data.excitation": ("pulses", "trapezoids"),
    "data.inspection": ("Inspection", "inspect"),
    "data.pieces": ("Log",),
    "data.reading": ("read",),
    "data.writing": ("write",),
    "data.record": ("Channel", "Injection", "InjectionPoint", "Record", "Tap", "Timing", "record_of"),
    "data.resampling": ("Resampling",),
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
    "exports.export": ("Export", "export", "read_estimated", "state_space"),
    "exports.joint_toml": ("JointToml",),
    "exports.linear": ("Matlab", "StateSpaceJson"),
    "exports.mjcf": ("Mjcf",),
    "exports.modelica": ("Modelica",),
    "exports.state_space": ("StateSpace",),
    "exports.urdf": ("Urdf",),
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
    "report.channels": ("channels_figure",),
    "report.figures": ("residual_figure", "save", "torque_figure"),
    "report.tuning_figure": ("tuning_figure",),
    "report.report": ("Report", "report_estimate", "report_file"),
    "simulation.closed_loop": ("Initial", "Outcome", "Simulation", "simulate", "simulate_many"),
    "simulation.drive_side": ("DriveSide",),
    "simulation.experiment": ("ClosedLoop", "prepare"),
    "simulation.open_loop": ("OpenLoop",),
    "simulation.synthesis": ("simulated_record",),
    "model.linear": ("frequency_response",),
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
    "Conversion",
    "Counterbalance",
    "Detectable",
    "DigitalFilter",
    "Dossier",
    "Drift",
    "Drive",
    "DriveSide",
    "DriveSideFit",
    "Estimate",
    "EstimatedParameter",
    "Export",
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
    "Inspection",
    "Intervals",
    "JointFile",
    "JointFileError",
    "JointToml",
    "JointidError",
    "LearnedLoop",
    "Log",
    "LongEstimate",
    "LoopCheck",
    "LoopTests",
    "Matlab",
    "MethodError",
    "Mjcf",
    "Modelica",
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
    "Report",
    "ReportComparison",
    "Resampling",
    "Revealing",
    "RigidJoint",
    "SecondOrder",
    "Simulation",
    "StateSpace",
    "StateSpaceController",
    "StateSpaceJson",
    "SymmetricFriction",
    "Tap",
    "Timing",
    "Transmission",
    "Tuned",
    "Tuning",
    "Twin",
    "Urdf",
    "Validation",
    "advice_answer",
    "advise",
    "channels_figure",
    "check_loop",
    "check_record",
    "compare",
    "compare_reports",
    "comparison_answer",
    "convert",
    "detectable",
    "dossier",
    "drift_answer",
    "estimate_answer",
    "export",
    "frequencies",
    "frequency_response",
    "identify",
    "identify_long",
    "identify_together",
    "inspect",
    "inspection_answer",
    "intervals",
    "learn_loop",
    "learned_answer",
    "load",
    "long_answer",
    "loop_answer",
    "prepare",
    "pulses",
    "read",
    "read_estimated",
    "read_report",
    "record_of",
    "report_estimate",
    "report_file",
    "residual_figure",
    "revealing",
    "revealing_answer",
    "rigid_sums",
    "save",
    "simulate",
    "simulate_many",
    "simulated_record",
    "simulation_answer",
    "state_space",
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
