"""The frozen description of the API, and the unit on every number."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from cellctl.api.app import create_app
from cellctl.api.openapi import numbers, text_of


@pytest.fixture(scope="module")
def document() -> dict[str, Any]:
    return create_app(None).openapi()


def test_the_description_is_the_frozen_one(document: dict[str, Any], root: Path) -> None:
    """A change is meant: python -m cellctl.api.openapi deploy/openapi.json"""
    assert text_of(document) == (root / "deploy/openapi.json").read_text(encoding="utf-8")


def test_every_number_carries_a_unit(document: dict[str, Any]) -> None:
    found = list(numbers(document))
    assert len(found) > 50
    assert [place for (place, _), node in found if "unit" not in node] == []


def test_every_operation_tells_problems_and_roles(document: dict[str, Any]) -> None:
    assert document["openapi"] == "3.1.0"
    for path, methods in document["paths"].items():
        for method, operation in methods.items():
            assert "application/problem+json" in operation["responses"]["4XX"]["content"], (path, method)
            assert operation["x-roles"], (path, method)


def test_every_reference_leads_somewhere(document: dict[str, Any]) -> None:
    schemas = document["components"]["schemas"]
    for part in json.dumps(document).split('"#/components/schemas/')[1:]:
        assert part.split('"', 1)[0] in schemas


def test_what_is_asked_is_closed(document: dict[str, Any]) -> None:
    for name, schema in document["components"]["schemas"].items():
        if name.endswith("Request"):
            assert schema["additionalProperties"] is False
