"""A table of the joint file: pydantic checks it, and what is wrong comes out in sentences of our own.

Every kind of value says in words what is expected of it (`Says`). A fault then needs no more than the value that
was received, whichever rule was broken, and none of pydantic's wording reaches the user.
"""

from __future__ import annotations

from itertools import chain
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, TypeAlias, get_args, get_origin

from pydantic import AfterValidator, BaseModel, ConfigDict, ModelWrapValidatorHandler, ValidationError, model_validator
from pydantic_core import InitErrorDetails, PydanticCustomError

from jointid.common import messages
from jointid.common.errors import JointidError
from jointid.common.messages import Says

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping

    from pydantic import GetJsonSchemaHandler
    from pydantic.fields import FieldInfo
    from pydantic.json_schema import JsonSchemaValue
    from pydantic_core import CoreSchema, ErrorDetails

_OURS = "joint_file"  # pydantic's type of the errors that are sentences already

Fault: TypeAlias = tuple[tuple[int | str, ...], str]
"""Where a fault is, below some table, and its sentence without that place at its beginning."""


class Table(BaseModel):
    """A table of the joint file; its fields are its keys, and what defaults to None may be left out."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True)

    shorthand: ClassVar[str | None] = None
    """The key whose value may be written instead of the whole table."""

    decided_by: ClassVar[Mapping[str, str]] = {}
    """Keys that hold one table or another, as a key of that table decides: controller by law."""

    builds: ClassVar[Any] = None
    """The dataclass whose settings its keys are, where that is one."""

    def build(self) -> Any:
        """Return the object that the table says."""
        return self.builds(**self.settings())

    def faults(self) -> Iterator[tuple[str, str]]:
        """Yield what is wrong with these values together: a key, or "" for the table, and the rest of a sentence."""
        if self.builds is not None and (refused := refusal(self.build)):
            yield "", refused

    def given(self, *without: str) -> dict[str, Any]:
        """Return the values that stand in the file, by key, without those named."""
        keys = [key for key in type(self).model_fields if key in self.model_fields_set and key not in without]
        return {key: getattr(self, key) for key in keys}

    def settings(self, *without: str) -> dict[str, Any]:
        """Return the values that stand in the file as the settings of a dataclass, by key, without those named."""
        given = self.given(*without)
        return {key: tuple(value) if isinstance(value, list) else value for key, value in given.items()}

    def lacks(self, key: str) -> str:
        """Return the rest of the sentence on a key that is needed beside the others and not there."""
        field = type(self).model_fields[key]
        return messages.missing(_expectation(field).expected, field.description or "")

    if TYPE_CHECKING:  # keys that are generated

        def __getattr__(self, name: str) -> Any: ...

    @model_validator(mode="wrap")
    @classmethod
    def _checked(cls, data: object, handler: ModelWrapValidatorHandler[Self]) -> Self:
        short = cls.shorthand is not None and not isinstance(data, dict)
        raw = {cls.shorthand: data} if short else data
        try:
            table = handler(raw)
            found: list[Fault] = [((key,) if key else (), sentence) for key, sentence in table.faults()]
        except ValidationError as error:
            found = [cls._fault(details, raw, short) for details in error.errors(include_url=False)]
        else:
            if not found:
                return table
        if short:  # its key is not in the file
            found = [((), sentence) for _, sentence in found]
        raise ValidationError.from_exception_data(cls.__name__, [_as_error(*fault) for fault in dict.fromkeys(found)])

    @classmethod
    def _fault(cls, error: ErrorDetails, raw: Any, short: bool) -> Fault:
        """Return one of pydantic's errors as a fault of ours."""
        if not error["loc"]:
            return (), messages.no_table(raw)
        key, *below = error["loc"]
        if error["type"] == _OURS:
            # Pydantic puts the decision into the location, below the key that holds the table.
            return (key, *(below[1:] if key in cls.decided_by else below)), error["ctx"]["sentence"]
        field = cls.model_fields.get(str(key))
        if field is None:
            return (key,), messages.unknown(str(key), cls.model_fields)
        if error["type"].startswith("union_tag"):
            deciding = cls.decided_by[str(key)]
            return (key, deciding), _describe_undecided(deciding, field, raw[key])
        if error["type"] == "missing":
            return (key,), messages.missing(_expectation(field).expected, field.description or "")
        return (key,), _describe_unexpected(field, raw[key], short)

    @classmethod
    def __get_pydantic_json_schema__(cls, core: CoreSchema, handler: GetJsonSchemaHandler) -> JsonSchemaValue:
        """Describe a table with a shorthand as what it is: that value, or the table."""
        table = handler(core)
        if cls.shorthand is None:
            return table
        return {"anyOf": [handler.resolve_ref_schema(table)["properties"][cls.shorthand], table]}


def sentences(error: ValidationError) -> list[str]:
    """Return the sentences of all that is wrong with a `Table`."""
    found = error.errors(include_url=False, include_input=False)
    return [f"{messages.dot_path(details['loc'])}{details['ctx']['sentence']}" for details in found]


def refusal(make: Callable[[], object]) -> str | None:
    """Return the rest of the sentence with which `make` refuses; None if it does not."""
    try:
        make()
    except JointidError as error:
        return f": {error}"
    return None


def accept_by(make: Callable[[Any], object]) -> AfterValidator:
    """Return the validator of a value that `make` must not refuse."""

    def checked(value: object) -> object:
        if refused := refusal(lambda: make(value)):
            raise _our_error(refused)
        return value

    return AfterValidator(checked)


def _our_error(sentence: str) -> PydanticCustomError:
    return PydanticCustomError(_OURS, "{sentence}", {"sentence": sentence})


def _as_error(location: tuple[int | str, ...], sentence: str) -> InitErrorDetails:
    return InitErrorDetails(type=_our_error(sentence), loc=location, input=None)


def _describe_undecided(deciding: str, field: FieldInfo, raw: Mapping[str, object]) -> str:
    """Return the rest of the sentence on a table that does not say which of several it is."""
    deciders = [table.model_fields[deciding] for table in _tables(field)]
    choices = [choice for decider in deciders for choice in _choices(decider)]
    if deciding in raw:
        return messages.no_choice(raw[deciding], choices)
    return messages.missing(messages.either(choices), deciders[0].description or "")


def _describe_unexpected(field: FieldInfo, value: object, short: bool) -> str:
    """Return the rest of the sentence on a value that is not what the key's annotation says."""
    if choices := _choices(field):
        return messages.no_choice(value, choices)
    says = _expectation(field)
    if _tables(field) and says not in field.metadata:
        return messages.no_table(value)
    expected = f"{says.expected}, or a table" if short else says.expected
    return messages.unexpected(value, Says(expected, says.negative), optional=not (short or field.is_required()))


def _expectation(field: FieldInfo) -> Says:
    """Return what is expected of a key's value."""
    says = [part for part in _parts(field) if isinstance(part, Says)]
    return says[0] if says else Says(messages.either(_choices(field)) or "a table")


def _choices(field: FieldInfo) -> list[str]:
    """Return the words among which a key chooses."""
    return [word for part in _parts(field) if get_origin(part) is Literal for word in get_args(part)]


def _tables(field: FieldInfo) -> list[type[Table]]:
    """Return the tables that a key may hold."""
    return [part for part in _parts(field) if isinstance(part, type) and issubclass(part, Table)]


def _parts(field: FieldInfo) -> Iterator[Any]:
    """Yield what a key's annotation is made of: what it says of itself, and its types."""
    return chain(field.metadata, _unfolded(field.annotation))


def _unfolded(annotation: Any) -> Iterator[Any]:
    """Yield the types and the metadata of an annotation; of a list or a dictionary, those of its items."""
    origin = get_origin(annotation)
    if origin is Annotated:
        yield from annotation.__metadata__
        yield from _unfolded(annotation.__origin__)
    elif origin in (None, Literal):
        yield annotation
    else:
        yield from chain.from_iterable(map(_unfolded, get_args(annotation)))
