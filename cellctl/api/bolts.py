"""What the results of a run prove for each bolt. Pure functions."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from pydantic import ValidationError

from cellctl.api.schemas import Bolt, BoltState
from cellctl.recipe import Recipe

VERIFY = "verify"
"""The stage behind those of the recipe: without it no bolt is finished."""


def bolts_of(recipe: Recipe, results: Iterable[Mapping[str, Any]]) -> list[Bolt]:
    """Every bolt of the recipe, with what its `results` (`index`, `stage`, `verdict`) prove."""
    due = [*(stage.name for stage in recipe.tighten.stages), VERIFY]
    of_bolt: dict[int, list[tuple[str, str]]] = {}
    for result in results:
        of_bolt.setdefault(result["index"], []).append((result["stage"], result["verdict"]))
    return [
        Bolt(index=index, angle_deg=angle, state=_state(due, of_bolt.get(index, [])))
        for index, angle in enumerate(recipe.pattern.angles())
    ]


def recipe_in(header: object) -> Recipe | None:
    """The recipe that stands in the header of a run; None where it is none that this version can read."""
    held = header.get("recipe") if isinstance(header, dict) else None
    try:
        return Recipe.model_validate_json(json.dumps(held))
    except ValidationError:
        return None


def _state(due: list[str], results: list[tuple[str, str]]) -> BoltState:
    """As the verdict counts: a result that is not OK stays, and each stage is due exactly once."""
    bad = [verdict for _, verdict in results if verdict != "ok"]
    if bad:
        return "nok" if "nok" in bad else "unknown"
    if not results:
        return "open"
    return "ok" if Counter(stage for stage, _ in results) == Counter(due) else "partial"
