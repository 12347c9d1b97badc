"""Canonical JSON: one value, one text, in every process.

Sorted keys, no white space, UTF-8. Non-finite floats become the strings "NaN", "Infinity", "-Infinity"; enums their
value; frozen dataclasses and pydantic models their fields; arrays nested lists; times RFC 3339; a path its file name
only, so that no folder of this machine enters a record.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping
from datetime import datetime
from enum import Enum
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel

from cellctl.stamps import rfc3339

Plain = None | bool | int | float | str | list[Any] | dict[str, Any]
PLAIN_TYPES = frozenset((str, int, bool, type(None)))
OnArray = Callable[[str, NDArray[Any]], Plain]
"""Gets the name of the field that holds an array, and the array; gives what stands in its place."""


def array_as_list(name: str, array: NDArray[Any]) -> Plain:
    """The array itself, as nested lists."""
    as_it_is = array.dtype.kind in "biu" or (array.dtype.kind == "f" and bool(np.isfinite(array).all()))
    plain: Plain = array.tolist() if as_it_is else plain_of(array.tolist())
    return plain


def plain_of(value: object, on_array: OnArray = array_as_list, *, name: str = "value") -> Any:
    """`value` in terms of JSON. Raises TypeError for what has no canonical form (sets, functions, bytes)."""
    if type(value) in PLAIN_TYPES or (type(value) is float and math.isfinite(value)):  # nearly every value
        return value
    if isinstance(value, Enum):
        return plain_of(value.value, on_array, name=name)
    if value is None or isinstance(value, bool | int | str):
        return value
    if isinstance(value, float):
        return float(value) if math.isfinite(value) else _non_finite(value)
    if isinstance(value, np.generic):
        return plain_of(value.item(), on_array, name=name)
    if isinstance(value, np.ndarray):
        return on_array(name, value)
    if isinstance(value, datetime):
        return rfc3339(value)
    if isinstance(value, PurePath):
        return value.name
    return _container(value, on_array, name)


def _container(value: object, on_array: OnArray, name: str) -> Any:
    if isinstance(value, dict):
        return {_key(key): plain_of(item, on_array, name=str(key)) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain_of(item, on_array, name=name) for item in value]
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = {field.name: getattr(value, field.name) for field in dataclasses.fields(value)}
        return {key: plain_of(item, on_array, name=key) for key, item in fields.items()}
    if isinstance(value, BaseModel):
        return plain_of(value.model_dump(), on_array, name=name)
    if isinstance(value, Mapping):
        return plain_of(dict(value), on_array, name=name)
    raise TypeError(f"{name}: a {type(value).__name__} has no canonical form")


def canonical(value: object) -> str:
    """Canonical JSON text of `value`."""
    return json.dumps(plain_of(value), sort_keys=True, separators=(",", ":"), ensure_ascii=False, allow_nan=False)


def number_of(value: object) -> float:
    """A float read back from canonical JSON, where a non-finite one stands as a string. NaN for anything else."""
    if isinstance(value, bool):
        return math.nan
    if isinstance(value, int | float):
        return float(value)
    return {"Infinity": math.inf, "-Infinity": -math.inf}.get(str(value), math.nan)


def _key(key: object) -> str:
    if type(key) is str:
        return key
    if isinstance(key, Enum):
        key = key.value
    if not isinstance(key, str | int) or isinstance(key, bool):
        raise TypeError(f"a {type(key).__name__} is no key of canonical JSON")
    return str(key)


def _non_finite(value: float) -> str:
    if math.isnan(value):
        return "NaN"
    return "Infinity" if value > 0 else "-Infinity"
