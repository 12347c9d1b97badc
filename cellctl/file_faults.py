"""Every fault of a file at once: what pydantic says about a model, as ConfigErrors with place, limit and unit."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from typing import Any, TypeVar

from pydantic import BaseModel, ValidationError

from hal.entries import without_kind
from hal.errors import ConfigError

M = TypeVar("M", bound=BaseModel)
UNION_BRANCHES = ("float", "constrained-float", "literal")
SIGNS = {"gt": ">", "ge": ">=", "lt": "<", "le": "<="}


def read_toml(text: str, source: str) -> dict[str, Any]:
    """TOML as a dictionary. Raises ConfigError with line and column of the first wrong character."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"not TOML: {error}", place=source) from None
    except RecursionError:
        raise ConfigError("not TOML: nested too deep", place=source) from None


def parsed(model: type[M], data: Mapping[str, Any], source: str) -> tuple[M | None, list[ConfigError]]:
    """The model of `data`, or None and everything that is wrong."""
    try:
        return model.model_validate(data), []
    except ValidationError as error:
        return None, faults_of(error, model, source)


def faults_of(error: ValidationError, model: type[BaseModel], source: str) -> list[ConfigError]:
    """One ConfigError for each wrong place, in the order of the file's sections."""
    schema = model.model_json_schema()
    faults = []
    for detail in error.errors(include_url=False):
        context = detail.get("ctx", {})
        limits = [f"{sign} {context[key]}" for key, sign in SIGNS.items() if key in context]
        loc = without_kind(detail["loc"])
        place = [source, *(str(part) for part in loc if not _branch(part))]
        unit = unit_at(schema, loc)
        faults.append(ConfigError(detail["msg"], place=".".join(place), limit=", ".join(limits), unit=unit))
    # Where one branch of a union has faults further inside, what the other branch says of the whole is no help.
    places = [fault.place for fault in faults]
    return [fault for fault in faults if not any(place.startswith(f"{fault.place}.") for place in places)]


def unit_at(schema: Mapping[str, Any], loc: tuple[int | str, ...]) -> str:
    """Unit of the field at `loc` in a JSON schema; empty where it has none."""
    definitions: Mapping[str, Any] = schema.get("$defs", {})
    here: list[Mapping[str, Any]] = [schema]
    for part in loc:
        if _branch(part):
            continue
        inner = [step for node in _opened(here, definitions) for step in _children(node, part)]
        here = inner or here
    return next((str(node["unit"]) for node in _opened(here, definitions) if "unit" in node), "")


def _opened(nodes: list[Mapping[str, Any]], definitions: Mapping[str, Any]) -> list[Mapping[str, Any]]:
    """References followed, alternatives side by side."""
    found: list[Mapping[str, Any]] = []
    for node in nodes:
        if "$ref" in node:
            target = definitions[str(node["$ref"]).rsplit("/", 1)[-1]]
            found += _opened([target], definitions)
        elif alternatives := node.get("anyOf") or node.get("oneOf"):
            found += _opened(list(alternatives), definitions)
        else:
            found.append(node)
    return found


def _children(node: Mapping[str, Any], part: int | str) -> list[Mapping[str, Any]]:
    if isinstance(part, int):
        return [node["items"]] if isinstance(node.get("items"), dict) else []
    properties = node.get("properties", {})
    return [properties[part]] if part in properties else []


def _branch(part: int | str) -> bool:
    """Whether a part of pydantic's place names a branch of a union and not a key of the file."""
    return isinstance(part, str) and ("[" in part or part in UNION_BRANCHES)
