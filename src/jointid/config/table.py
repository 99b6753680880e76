"""A table of the joint file and its keys: pydantic checks it, and what is wrong comes out in sentences of our own.

Every kind of value says in words what is expected of it (`Says`). A fault then needs no more than the value that
was received, whichever rule was broken, and none of pydantic's wording reaches the user.

Keys are made from the settings of dataclasses: what a key may hold, its default and its description are those of the
setting's declaration (`jointid.common.settings`).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias, TypeVar, get_args, get_origin

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    ModelWrapValidatorHandler,
    ValidationError,
    ValidatorFunctionWrapHandler,
    WrapValidator,
    create_model,
    model_validator,
)
from pydantic_core import InitErrorDetails, PydanticCustomError

from jointid.common import messages
from jointid.common.errors import Fault, JointidError
from jointid.common.messages import Says
from jointid.common.settings import Declared, settings_of
from jointid.common.units import units_of
from jointid.config.deleted import sentence_of
from jointid.config.quantities import Stated, is_quantity, list_units, misfit, to_si

if TYPE_CHECKING:
    from pydantic import GetJsonSchemaHandler
    from pydantic.fields import FieldInfo
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema, ErrorDetails

_OURS = "joint_file"  # pydantic's type of the errors that are sentences already

Place: TypeAlias = tuple[int | str, ...]
"""Keys and indices that lead to a value."""

Located: TypeAlias = tuple[Place, str, str]
"""Place of a fault below some table, its code, and its sentence without the place at its beginning."""

CONTRADICTION = "contradiction"
"""Code of a fault of values that are right by themselves."""


def fault_at(place: Place, rest: str, code: str = CONTRADICTION) -> Fault:
    """Return a fault whose sentence begins with its place."""
    if code == "unknown":
        rest = sentence_of(place) or rest
    return Fault(f"{messages.dot_path(place)}{rest}", place, code)


class Table(BaseModel):
    """A table of the joint file; its fields are its keys, and what defaults to None may be left out."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, defer_build=True)

    shorthand: ClassVar[str | None] = None
    """The key whose value may be written instead of the whole table."""

    decided_by: ClassVar[Mapping[str, str]] = {}
    """Keys whose table depends on one of its own keys: controller on law."""

    ambiguous: ClassVar[Mapping[str, str]] = {}
    """Ambiguous names that are refused, with the rest of the sentence on the choices."""

    builds: ClassVar[Any] = None
    """The dataclass whose settings its keys are, where that is one."""

    def build(self) -> Any:
        """Return the object that the table describes."""
        return self.builds(**self.settings())

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield contradictions between the values: a key, or "" for the table, and a sentence without its place."""
        if self.builds is not None and (refused := refusal(self.build)):
            yield "", refused

    def given_values(self, *without: str) -> dict[str, Any]:
        """Return the values that stand in the file, by key, without those named."""
        keys = [key for key in type(self).model_fields if key in self.model_fields_set and key not in without]
        given = {key: getattr(self, key) for key in keys}
        return {key: float(value) if isinstance(value, Stated) else value for key, value in given.items()}

    def settings(self, *without: str) -> dict[str, Any]:
        """Return the values that stand in the file as the settings of a dataclass, by key, without those named."""
        given = self.given_values(*without)
        return {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}

    @classmethod
    def correct_keys(cls, raw: Mapping[str, Any], *path: str) -> tuple[dict[str, Any], list[Fault]]:
        """Return nested tables with corrected misspelt keys, and a fault for each.

        A required key that is misspelt is then not reported as missing as well.
        """
        found, faults = dict[str, Any](), list[Fault]()
        for key, value in raw.items():
            meant = key
            if key not in cls.model_fields and key not in cls.ambiguous and sentence_of((*path, key)) is None:
                near = messages.nearest(key, cls.model_fields)
                if near is not None and near not in raw and near not in found:
                    meant = near
                    faults.append(
                        fault_at((*path, key), messages.describe_unknown_name(key, cls.model_fields), "unknown")
                    )
            field = cls.model_fields.get(meant)
            below = [] if field is None or get_origin(field.annotation) in (dict, list) else _tables(field)
            found[meant] = value
            if len(below) == 1 and isinstance(value, dict):
                found[meant], more = below[0].correct_keys(value, *path, key)
                faults += more
        return found, faults

    @classmethod
    def find_missing(cls, given: Collection[str]) -> Iterator[tuple[str, str]]:
        """Yield missing keys, where one of several is needed beside the given keys."""
        yield from ()

    @classmethod
    def lacks(cls, key: str) -> str:
        """Return the rest of the sentence on a missing key."""
        field = cls.model_fields[key]
        return messages.missing(_expectation(field).expected, field.description or "")

    if TYPE_CHECKING:  # keys that are generated

        def __getattr__(self, name: str) -> Any: ...

    @model_validator(mode="wrap")
    @classmethod
    def _check_table(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        short = cls.shorthand is not None and not isinstance(data, dict)
        raw = {cls.shorthand: data} if short else data
        try:
            table = handler(raw)
            found: list[Located] = [((key,) if key else (), CONTRADICTION, rest) for key, rest in table.faults()]
        except ValidationError as error:
            given = set(raw) if isinstance(raw, dict) else set[str]()
            faulty = error.errors(include_url=False)
            absent = [((key,), "missing", rest) for key, rest in cls.find_missing(given)] if given else []
            if given & set(cls.ambiguous):  # which may be what is missing
                faulty, absent = [one for one in faulty if one["type"] != "missing"], []
            found = [*(cls._fault(one, raw, short) for one in faulty), *absent]
        else:
            if not found:
                return table
        if short:  # its key is not in the file
            found = [((), code, rest) for _, code, rest in found]
        errors: list[InitErrorDetails] = [
            {"type": _our_error(code, rest), "loc": place, "input": None} for place, code, rest in dict.fromkeys(found)
        ]
        raise ValidationError.from_exception_data(cls.__name__, errors)

    @classmethod
    def _fault(cls, error: ErrorDetails, raw: Any, short: bool) -> Located:
        """Return one of pydantic's errors as a fault of ours."""
        if not error["loc"]:
            return (), "table", messages.no_table(raw)
        key, *below = error["loc"]
        if error["type"] == _OURS:
            # Pydantic puts the decision into the location, below the key that holds the table.
            place = (key, *(below[1:] if key in cls.decided_by else below))
            return place, error["ctx"]["code"], error["ctx"]["rest"]
        field = cls.model_fields.get(str(key))
        if field is None:
            rest = cls.ambiguous.get(str(key)) or messages.describe_unknown_name(str(key), cls.model_fields)
            return (key,), "unknown", rest
        if error["type"].startswith("union_tag"):
            deciding = cls.decided_by[str(key)]
            return (key, deciding), "choice", _describe_choice(deciding, field, raw[key])
        if error["type"] == "missing":
            return (key,), "missing", cls.lacks(str(key))
        return (key,), "value", _describe_value(field, raw[key], short)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe a table with a shorthand as what it is: that value, or the table."""
        table = handler(core)
        if cls.shorthand is None:
            return table
        return {"anyOf": [handler.resolve_ref_schema(table)["properties"][cls.shorthand], table]}


def faults_of(error: ValidationError) -> list[Fault]:
    """Return the faults of a `Table`."""
    found = error.errors(include_url=False, include_input=False)
    return [fault_at(details["loc"], details["ctx"]["rest"], details["ctx"]["code"]) for details in found]


def refusal(make: Callable[[], object]) -> str | None:
    """Return the rest of the sentence with which `make` refuses; None if it does not."""
    try:
        make()
    except JointidError as error:
        return f": {error}"
    return None


def accept_by(make: Callable[[Any], object]) -> AfterValidator:
    """Return the validator of a value that `make` must not refuse."""

    def check(value: object) -> object:
        if refused := refusal(lambda: make(value)):
            raise _our_error("refused", refused)
        return value

    return AfterValidator(check)


def _our_error(code: str, rest: str) -> PydanticCustomError:
    return PydanticCustomError(_OURS, "{rest}", {"code": code, "rest": rest})


def _describe_choice(deciding: str, field: FieldInfo, raw: Mapping[str, object]) -> str:
    """Return the rest of the sentence on a missing or unknown deciding key."""
    deciders = [table.model_fields[deciding] for table in _tables(field)]
    choices = [choice for decider in deciders for choice in _choices(decider)]
    if deciding in raw:
        return messages.no_choice(raw[deciding], choices)
    return messages.missing(messages.either(choices), deciders[0].description or "")


def _describe_value(field: FieldInfo, value: object, short: bool) -> str:
    """Return the rest of the sentence on a value of the wrong type."""
    if choices := _choices(field):
        return messages.no_choice(value, choices)
    says = _expectation(field)
    if _tables(field) and says not in field.metadata:
        return messages.no_table(value)
    expected = f"{says.expected}, or a table" if short else says.expected
    return messages.describe_unexpected_value(
        value, Says(expected, says.negative), optional=not (short or field.is_required())
    )


def _expectation(field: FieldInfo) -> Says:
    """Return the expected value of a key, in words."""
    says = [part for part in _parts(field) if isinstance(part, Says)]
    return says[0] if says else Says(messages.either(_choices(field)) or "a table")


def _choices(field: FieldInfo) -> list[str]:
    """Return the words among which a key chooses."""
    return [word for part in _parts(field) if get_origin(part) is Literal for word in get_args(part)]


def _tables(field: FieldInfo) -> list[type[Table]]:
    """Return the tables that a key may hold."""
    return [part for part in _parts(field) if isinstance(part, type) and issubclass(part, Table)]


def _parts(field: FieldInfo) -> Iterator[Any]:
    """Yield the metadata and the types of a key's annotation."""
    return chain(field.metadata, _flatten(field.annotation))


def _flatten(annotation: Any) -> Iterator[Any]:
    """Yield types and metadata of an annotation, or of the items of a container."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from annotation.__metadata__
        yield from _flatten(annotation.__origin__)
    elif origin in (None, Literal):
        yield annotation
    else:
        yield from chain.from_iterable(map(_flatten, get_args(annotation)))


# Keys made from settings

T = TypeVar("T", bound=Table)
Typed = tuple[Any, Any]
"""Annotation of a key, and its default or factory; ... for a required key."""

_LENGTH_UNITS = units_of("length")
MOST = 10**9
"""Of what is counted."""


def _not_nan(value: float) -> float:
    if math.isnan(value):
        raise ValueError
    return value


def flatten_keys(value: object) -> object:
    """Return nested tables as one with dotted names: TOML nests ``filter.depth = 0.1``."""
    if not isinstance(value, dict):
        return value
    found: dict[str, object] = {}
    for key, below in value.items():
        inner = flatten_keys(below)
        found |= {f"{key}.{name}": one for name, one in inner.items()} if isinstance(inner, dict) else {key: inner}
    return found


def _length_unit(name: str) -> str:
    if name not in _LENGTH_UNITS:
        raise ValueError
    return name


Text = Annotated[str, Field(min_length=1), Says("text in quotes")]
LengthUnit = Annotated[str, AfterValidator(_length_unit), Says(f"a unit of length, one of {', '.join(_LENGTH_UNITS)}")]
Flag = Annotated[bool, Says("true or false")]

Number = Annotated[float, Field(allow_inf_nan=False), Says("a number")]
Positive = Annotated[float, Field(gt=0, allow_inf_nan=False), Says("a positive number")]
Bound = Annotated[float, AfterValidator(_not_nan), Says("a number, inf or -inf")]

Size = Annotated[
    float, Field(gt=0, allow_inf_nan=False), Says("a positive number", "use sign = -1 to turn the load round")
]

Natural = Annotated[int, Field(ge=0, le=MOST), Says("a whole number, 0 or more")]
Borders = Annotated[list[Natural], Field(min_length=2, max_length=2), Says("a list of two whole numbers, 0 or more")]

Names = Annotated[list[Text], Says("a list of names in quotes")]
Numbers = Annotated[list[Number], Says("a list of numbers")]
Coefficients = Annotated[list[Number], Field(min_length=1), Says("a list of one or more numbers")]
Matrix = Annotated[list[list[Number]], Says("a list of rows, each a list of numbers")]
ControllerNumbers = Annotated[dict[str, Number], BeforeValidator(flatten_keys)]
"""By their names, those of a filter with points."""

_PLAIN: Mapping[Any, Any] = {
    bool: Flag, str: Text, tuple[str, ...]: Names, tuple[int, int]: Borders, tuple[float, ...]: Coefficients,
    Mapping[str, float]: ControllerNumbers,
}  # fmt: skip


def keys_from(
    *owners: type,
    without: Collection[str] = (),
    types: Mapping[str, Typed] | None = None,
) -> Callable[[type[T]], type[T]]:
    """Return the decorator that gives a table a key for each setting of some dataclasses.

    A key that several of them have is optional and says what it means in each, unless they declare it alike.

    Args:
        owners: the dataclasses.
        without: names of settings that are no keys, or that the table declares itself.
        types: annotation and default of keys that hold a table, or something else that is not a setting's own type.
    """
    declared: dict[str, list[Declared]] = {}
    for owner in owners:
        for one in settings_of(owner):
            if one.name not in without:
                declared.setdefault(one.name, []).append(one)
    keys = {name: _key(same, (types or {}).get(name)) for name, same in declared.items()}
    return with_keys(keys, owners[0] if len(owners) == 1 else None)


def keys_of_kinds(kinds: Mapping[str, type]) -> Callable[[type[T]], type[T]]:
    """Return the decorator that gives a table every key of several kinds, each optional and described by its kinds.

    Args:
        kinds: the dataclass of each kind, by the word for it.
    """
    declared: dict[str, list[Declared]] = {}
    for kind, owner in kinds.items():
        for one in settings_of(owner):
            described = replace(one.setting, help=f"of {kind}: {one.setting.help}")
            declared.setdefault(one.name, []).append(replace(one, setting=described))
    return with_keys({name: _key(same, (annotation_of(same[0]), None)) for name, same in declared.items()})


def with_keys(keys: Mapping[str, Typed], builds: type | None = None) -> Callable[[type[T]], type[T]]:
    """Return the decorator that gives a table further keys."""

    def complete(table: type[T]) -> type[T]:
        make: Any = create_model
        made: type[T] = make(table.__name__, __base__=table, __module__=table.__module__, __doc__=table.__doc__, **keys)
        made.builds = builds
        return made

    return complete


def _key(same: Sequence[Declared], typed: Typed | None) -> Typed:
    """Return annotation and field of a key, from its declarations."""
    unit = same[0].setting.unit
    described = "; ".join(dict.fromkeys(one.setting.help for one in same)) + (f" [{unit}]" if unit else "")
    annotation, default = typed or (annotation_of(same[0]), _default(same))
    if callable(default):
        return annotation, Field(default_factory=default, description=described)
    return annotation if default is not None else annotation | None, Field(default, description=described)


def _default(same: Sequence[Declared]) -> Any:
    """Return a key's default; None where declarations differ or there is none."""
    defaults = {str(one.default): one for one in same}
    if len(defaults) > 1:
        return None
    if same[0].required:
        return ...
    if same[0].factory is not None:
        return same[0].factory
    value = same[0].default
    if isinstance(value, float) and not math.isfinite(value):
        return None  # which TOML cannot write
    if isinstance(value, tuple):
        return list(value)
    return str(value) if isinstance(value, str) else value


def annotation_of(one: Declared) -> Any:
    """Return the pydantic annotation of a setting."""
    found = _annotation_of(one)
    if one.setting.accept is not None:
        found = Annotated[found, accept_by(one.setting.accept)]
    return found | Literal[one.setting.none] if one.setting.none else found


def _annotation_of(one: Declared) -> Any:
    declared = one.setting
    if declared.choices and declared.accept is not None:
        return Annotated[Text, Field(json_schema_extra={"enum": list(declared.choices)})]
    if one.choices:
        return Literal[*one.choices]
    allowed = AfterValidator(_make_validator(one))
    if declared.only:  # a Literal would take true for 1
        return Annotated[int, allowed, Field(json_schema_extra={"enum": [*declared.only]}), one.says]
    if one.type is float:
        bounds = Field(gt=declared.above, ge=declared.at_least, le=declared.at_most, allow_inf_nan=declared.infinite)
        number = Annotated[float, bounds, allowed, one.says]
        return with_unit(number, declared.unit) if list_units(declared.unit) else number
    if one.type is int:
        return Annotated[int, Field(gt=declared.above, ge=declared.at_least, le=declared.at_most or MOST), one.says]
    return _PLAIN[one.type]


def with_unit(number: Any, declared: str) -> Any:
    """Return the annotation of a number that may be given with a unit too, as a text.

    Args:
        number: its annotation.
        declared: its unit, see `list_units`.
    """

    def read(value: object, handler: ValidatorFunctionWrapHandler) -> object:
        if not isinstance(value, str) or not is_quantity(value):
            return handler(value)
        if (fault := misfit(value, declared)) is not None:
            raise _our_error("unit", fault)
        said = to_si(value, declared)
        handler(float(said))
        return said

    return Annotated[number, WrapValidator(read), Field(json_schema_extra=_or_text)]


def _or_text(described: dict[str, Any]) -> None:
    """Add to the schema of a number that it may be a text with a unit."""
    said = ("title", "description", "default")
    number = {key: described.pop(key) for key in list(described) if key not in said}
    described["anyOf"] = [number, {"type": "string", "description": "a number with its unit"}]


def _make_validator(one: Declared) -> Callable[[float], float]:
    """Return the validator of a setting apart from its bounds: NaN, 0, or a choice."""

    def check(value: float) -> float:
        if one.fault(value) is not None:
            raise ValueError
        return value

    return check
