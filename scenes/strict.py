"""Files in TOML to attrs classes, strictly: unknown keys, wrong types and values out of range are refused.

cattrs alone takes "0.5" and true for a number and hides a validator's message in a tree of exceptions; here the first
fault becomes one line: file, field, value, and what is allowed.
"""

import tomllib
from pathlib import Path
from typing import Any, Literal, TypeVar, get_args, get_origin

import attrs
import cattrs
from cattrs.errors import AttributeValidationNote, IterableValidationNote
from cattrs.gen import make_dict_structure_fn

T = TypeVar("T")


class FileError(ValueError):
    """A file that cannot be used; the message is one line and names the file."""


def read(path: Path, kind: type[T], converter: cattrs.Converter) -> T:
    """Read a TOML file into the attrs class `kind`.

    Raises
    ------
    FileError : the file is missing, is not TOML, or holds an unknown key or a value that is not allowed.
    """
    try:
        description = tomllib.loads(path.read_text("utf-8"))
    except OSError as error:
        raise FileError(f"{path}: cannot be read: {error.strerror or error}") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise FileError(f"{path}: is not TOML: {' '.join(str(error).split())}") from None
    try:
        return converter.structure(description, kind)
    except cattrs.BaseValidationError as error:
        raise FileError(f"{path}: {_first_fault(error, description)}") from None


def converter() -> cattrs.Converter:
    """A converter that refuses what it does not know; classes may register hooks of their own."""
    strict = cattrs.Converter(forbid_extra_keys=True)
    strict.register_structure_hook(float, _number)
    strict.register_structure_hook(int, _integer)
    strict.register_structure_hook(bool, _exactly(bool, "true or false"))
    strict.register_structure_hook(str, _exactly(str, "a string"))
    strict.register_structure_hook_func(lambda kind: get_origin(kind) is Literal, _choice)

    def fixed_list(value: Any, kind: Any) -> Any:
        kinds = get_args(kind)
        if not isinstance(value, list) or len(value) != len(kinds):
            raise TypeError(f"a list of {len(kinds)}")
        try:
            return tuple(strict.structure(item, each) for item, each in zip(value, kinds, strict=True))
        except TypeError as error:
            raise TypeError(f"a list of {len(kinds)}, each {error}") from None

    strict.register_structure_hook_func(
        lambda kind: get_origin(kind) is tuple and Ellipsis not in get_args(kind), fixed_list
    )

    def sequence(value: Any, kind: Any) -> Any:
        if not isinstance(value, list):  # a string is a sequence of letters
            raise TypeError("a list")
        return items(value, kind)

    def any_length(kind: Any) -> bool:
        return get_origin(kind) is tuple and Ellipsis in get_args(kind)

    def mapping(value: Any, kind: Any) -> Any:
        if not isinstance(value, dict):
            raise TypeError("a table")
        return value if Any in get_args(kind) else entries(value, kind)

    items = strict.get_structure_hook(tuple[Any, ...])
    entries = strict.get_structure_hook(dict[str, int])
    strict.register_structure_hook_func(any_length, sequence)
    strict.register_structure_hook_func(lambda kind: get_origin(kind) is dict, mapping)

    def table(kind: type) -> Any:
        structure = make_dict_structure_fn(kind, strict, _cattrs_forbid_extra_keys=True)

        def hook(value: Any, target: type) -> Any:
            if not isinstance(value, dict):
                raise TypeError("a table")
            return structure(value, target)

        return hook

    strict.register_structure_hook_factory(attrs.has, table)
    return strict


def _number(value: Any, _kind: type) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("a number")
    return float(value)


def _integer(value: Any, _kind: type) -> int:
    if isinstance(value, bool) or not isinstance(value, int):
        raise TypeError("an integer")
    return value


def _exactly(kind: type, allowed: str) -> Any:
    def structure(value: Any, _kind: type) -> Any:
        if not isinstance(value, kind):
            raise TypeError(allowed)
        return value

    return structure


def _choice(value: Any, kind: Any) -> Any:
    if value not in get_args(kind):
        raise TypeError(" or ".join(map(repr, get_args(kind))))
    return value


def _first_fault(error: BaseException, description: Any) -> str:
    """One line for the first fault in cattrs' tree of errors: the path of the field, its value, what is allowed."""
    path = ""
    value: Any = description
    while isinstance(error, cattrs.BaseValidationError):
        if isinstance(error, cattrs.ForbiddenExtraKeysError):
            break
        # An unknown key first: a misspelt one also makes a required field missing.
        unknown = [fault for fault in error.exceptions if isinstance(fault, cattrs.ForbiddenExtraKeysError)]
        error = (unknown or error.exceptions)[0]
        for note in getattr(error, "__notes__", ()):
            if isinstance(note, AttributeValidationNote):
                step: int | str = note.name
            elif isinstance(note, IterableValidationNote):
                step = note.index
            else:
                continue
            path += f"[{step}]" if isinstance(step, int) else f".{step}" if path else str(step)
            value = _descend(value, step)
    if isinstance(error, cattrs.ForbiddenExtraKeysError):
        allowed = sorted(field.name.lstrip("_") for field in attrs.fields(error.cl))
        extra = sorted(error.extra_fields)[0]
        prefix = f"{path}." if path else ""
        return f"{prefix}{extra} = {_descend(value, extra)!r}: unknown key: allowed are {', '.join(allowed)}"
    if isinstance(error, KeyError):
        return f"{path}: is missing"
    message = " ".join(str(error).split())
    if isinstance(error, TypeError):
        return f"{path} = {value!r}: allowed is {message}"
    return f"{path}: {message}" if path else message


def _descend(value: Any, step: Any) -> Any:
    try:
        return value[step]
    except (KeyError, IndexError, TypeError):
        return value
