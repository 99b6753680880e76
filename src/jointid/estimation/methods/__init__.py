"""The identification methods and their properties.

A method is a file of this folder with a frozen dataclass of its settings, a `Method` whose name is that of the file.
It is read by identification, the joint file with its checks, the command line, and the comparison.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from pkgutil import iter_modules
from typing import TYPE_CHECKING, Any, ClassVar, Literal, Protocol

from jointid.common.errors import MethodError
from jointid.common.settings import check_settings, declare, setting, settings_of

if TYPE_CHECKING:
    from jointid.common.messages import Progress
    from jointid.common.parameters import Parameter
    from jointid.estimation.result.estimate import Estimate
    from jointid.models.controllers import Controller
    from jointid.models.joints import ClosedLoop, Joint
    from jointid.records.record import Record
    from jointid.records.signals.filtering import Filtering

METHODS = tuple(sorted(module.name for module in iter_modules(__path__)))
"""The names of the methods, none of which is loaded; of two whose needs are met the first is the default."""

MethodName: Any = Literal[tuple(METHODS)]
"""The type of a method's name: one of `METHODS`."""

MODELS = ("rigid", "flexible")
"""The models of a joint."""

ROBOT = ("robot",)
"""The system of settings that are a robot's alone."""

CALLED: Mapping[str, str] = {"rigid": "a rigid joint", "flexible": "a flexible joint", "robot": "a robot"}
"""What sentences call them."""

OFFSETS: Any = setting(True, "of a robot: whether a constant torque of each motor is identified, too", systems=ROBOT)
EVALUATIONS: Any = setting(
    60,
    "of a robot: simulations with derivatives at most, of each search of springs or of nonlinear laws",
    at_least=1,
    systems=ROBOT,
)
_FREQUENCIES = declare(
    "of a robot: by the names of the flexible joints the frequencies of motor against link, Hz, at which the search of "
    "springs begins; without them they are searched",
    systems=ROBOT,
)
FREQUENCIES: Any = field(default_factory=dict, hash=False, metadata=_FREQUENCIES)
"""Settings of the methods that simulate a robot."""


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """The input of a method.

    Attributes:
        record: the log.
        joint: the model.
        loop: the joint under its controller; None if unknown, which methods that need it never receive.
        parameters: of the joint; free ones are estimated. A stated start replaces that of the method.
        filtering: how the signals are filtered.
        progress: receives the iterations.
        others: records that are identified with the first in one fit, by a method that stacks them.
    """

    record: Record
    joint: Joint
    loop: ClosedLoop | None
    parameters: tuple[Parameter, ...]
    filtering: Filtering
    progress: Progress
    others: tuple[Record, ...] = ()


class Method(Protocol):
    """One identification method: a dataclass of its settings that inherits from this.

    Attributes:
        name: in the joint file, on the command line and in an answer.
        title: in a report.
        default_for: the types of models for which it is the default method.
        robots: the types of models of robots that it identifies.
        stacks: whether it identifies one joint from several records, see `Task.others`.
        simulates: the "loop" under its controllers, with springs and frictions of any law; its estimate then keeps
            problem and solution. Or the load along the measured "motion" of the motors; or nothing, "".
        outputs: the reproduced signal of a simulated loop, "torque" or "motor_position"; empty for the logged one.
        free: names of identified numbers around the joint.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    default_for: ClassVar[tuple[Any, ...]] = ()
    robots: ClassVar[tuple[type, ...]] = ()
    stacks: ClassVar[bool] = False
    simulates: ClassVar[Literal["loop", "motion", ""]] = ""
    outputs: tuple[str, ...] = ()
    free: tuple[str, ...] = ()

    def __init_subclass__(cls) -> None:
        super().__init_subclass__()
        _LOADED[cls.name] = cls

    def __post_init__(self) -> None:
        check_settings(self)

    @classmethod
    def channels(cls, model: str, controller: Controller | None = None) -> tuple[str, ...]:
        """Names of its channels; for an unknown controller, only the reference."""
        if not cls.simulates and model == "flexible":
            return "torque", "motor_position", "load_position"
        if cls.simulates != "loop":
            return "torque", "motor_position"
        return ("torque", *(("reference",) if controller is None else controller.channels))

    def require_settings_of(self, system: str) -> None:
        """Refuse a setting without effect for a "rigid", "flexible" or "robot" system.

        Raises:
            MethodError: such a setting is not at its default.
        """
        for one in settings_of(type(self)):
            systems, default = one.systems, one.default
            if systems and system not in systems and getattr(self, one.name) != default:
                meant = " or ".join(CALLED[each] for each in systems)
                raise MethodError(
                    f"{type(self).__name__}.{one.name} is for {meant}, and this is {CALLED[system]}; leave it out."
                )

    def identify(self, task: Task) -> Estimate:
        """Identify a joint from a record."""
        ...

    def identify_robot(
        self, model: Any, logs: Sequence[Sequence[Record]], filtering: Filtering, known: Mapping[str, Parameter],
        progress: Progress,
    ) -> Estimate:  # fmt: skip
        """Identify one of `robots` from its joints' records, one or more logs."""
        ...


_LOADED: dict[str, type[Method]] = {}


def method_of(name: str) -> type[Method]:
    """Return the class of the method of that name."""
    if name not in _LOADED:
        import_module(f"{__name__}.{name}")
    return _LOADED[name]


def default_method(model: object) -> Method:
    """Return the default method of a model, with its default settings."""
    if not (fitting := [one for one in map(method_of, METHODS) if isinstance(model, one.default_for)]):
        raise MethodError(f"A joint, a robot or a loop of one is identified; received {type(model).__name__}.")
    return fitting[0]()
