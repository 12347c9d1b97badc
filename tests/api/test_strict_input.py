"""What is not clean is refused with its place, and never blocks the loop."""

from __future__ import annotations

import asyncio
import time
from collections.abc import AsyncIterator
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from cellctl.api.problems import ProblemError
from cellctl.api.strict import parse
from tests.api.harness import ORDER, Api, run_api

URL = "/api/v1/job-orders"
JSON = {"Content-Type": "application/json"}
GOOD = (
    '{"job_order_id": "J", "recipe": "lpt_shaft_36", "recipe_version": %s, "serials": {"rotor": "R", "shaft": "S"}%s}'
)


@pytest.mark.parametrize(
    ("body", "told"),
    [
        (GOOD % ("NaN", ""), "NaN"),
        (GOOD % ("Infinity", ""), "Infinity"),
        (GOOD % ("1e999", ""), "not finite"),
        (GOOD % ("1", ', "recipe": "x"'), "twice"),
        (GOOD % ("1", ', "color": "red"'), "/color"),
        (GOOD % ('"1"', ""), "/recipe_version"),
        (GOOD % ("true", ""), "/recipe_version"),
        (GOOD % ("1.0", ""), "/recipe_version"),
        (GOOD % ("0", ""), "/recipe_version"),
        (GOOD % ("9" * 5000, ""), "digits"),
        (GOOD.replace('"J"', '"../../etc"') % ("1", ""), "/job_order_id"),
        (GOOD.replace('"R"', "null") % ("1", ""), "/serials/rotor"),
        (GOOD % ("1", ', "\\ud800": 1'), "unicode"),
        ("{", "line 1"),
        ("[" * 100_000, "deeply"),
        ("[]", "valid dictionary"),
        ("", "required"),
        ("null", "valid dictionary"),
        ('"x"', "valid dictionary"),
    ],
)
def test_an_unclean_body_is_refused_with_its_place(tmp_path: Path, body: str, told: str) -> None:
    async def send(api: Api) -> None:
        await api.idle()
        answer = await api.client.post(URL, content=body.encode(), headers=JSON)
        assert answer.status_code == 422
        assert answer.headers["content-type"] == "application/problem+json"
        assert told.lower() in answer.text.lower()
        assert api.sessions == []

    run_api(tmp_path, send)


def test_a_body_that_is_not_utf8_is_refused(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        for body in (b"\xff\xfe{\x00}\x00", b'{"a": "\xff"}', "{}".encode("utf-32")):
            answer = await api.client.post(URL, content=body, headers=JSON)
            assert (answer.status_code, answer.json()["code"]) == (422, "invalid_json")

    run_api(tmp_path, send)


def test_a_body_of_12_mb_is_refused_quickly(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        body = b"[" + b"1.0," * 3_000_000 + b"1]"
        began = time.perf_counter()
        answer = await api.client.post(URL, content=body, headers=JSON)
        assert time.perf_counter() - began < 1.0
        assert (answer.status_code, answer.json()["code"]) == (413, "body_too_large")

    run_api(tmp_path, send)


def test_half_a_body_is_given_up_in_time(tmp_path: Path) -> None:
    async def half() -> AsyncIterator[bytes]:
        yield b'{"job_order_id": '
        await asyncio.sleep(3600)
        yield b'"J"}'

    async def send(api: Api) -> None:
        began = asyncio.get_running_loop().time()
        answer = await api.client.post(URL, content=half(), headers=JSON)
        assert (answer.status_code, answer.json()["code"]) == (408, "body_late")
        assert asyncio.get_running_loop().time() - began == pytest.approx(10.0)

    run_api(tmp_path, send)


def test_other_refusals_are_problem_details_too(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        for method, path, status in (
            ("GET", "/api/v1/nothing", 404),
            ("DELETE", "/api/v1/cell", 405),
            ("GET", "/api/v1/runs/none", 404),
            ("GET", "/api/v1/runs/..%2f..%2fetc", 404),
            ("GET", "/api/v1/runs?limit=0", 422),
            ("GET", "/api/v1/runs?limit=1e3", 422),
            ("GET", "/api/v1/runs?cursor=none", 404),
            ("GET", "/api/v1/job-orders/none", 404),
            ("GET", "/api/v1/dry-runs/none", 404),
            ("GET", "/api/v1/recipes/none", 404),
            ("GET", "/api/v1/recipes/lpt_shaft_36/versions/x", 422),
            ("GET", "/page/secret.txt", 422),
            ("GET", "/docs", 404),
        ):
            answer = await api.client.request(method, path)
            assert (answer.status_code, answer.headers["content-type"]) == (status, "application/problem+json"), path
            assert {"type", "title", "status", "detail", "code", "state"} <= set(answer.json())

    run_api(tmp_path, send)


def test_a_status_has_one_title_whatever_refuses(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        by_schema = await api.client.get("/api/v1/runs?limit=0")
        by_hand = await api.client.get("/api/v1/events", headers={"Last-Event-ID": "x"})
        by_book = await api.client.post(URL, json=ORDER | {"recipe_version": 999})
        not_json = await api.client.post(URL, content="{", headers=JSON)
        answers = [by_schema, by_hand, by_book, not_json]
        told = {(answer.status_code, answer.json()["title"]) for answer in answers}
        assert told == {(422, "Unprocessable Content")}
        large = await api.client.post(URL, content=b" " * (1 << 21), headers=JSON)
        assert (large.status_code, large.json()["title"]) == (413, "Content Too Large")

    run_api(tmp_path, send)


def test_an_unforeseen_error_tells_nothing_of_itself(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        def broken() -> str:
            raise RuntimeError("inner secret")

        object.__setattr__(api.services, "not_ready", broken)
        answer = await api.client.get("/api/v1/health/ready")
        assert (answer.status_code, answer.json()["code"]) == (500, "internal_error")
        assert "secret" not in answer.text

    run_api(tmp_path, send)


@settings(max_examples=200)
@given(st.binary(max_size=200))
def test_any_bytes_are_parsed_or_refused(body: bytes) -> None:
    try:
        parse(body)
    except ProblemError as error:
        assert error.status_code == 422


@given(st.recursive(st.none() | st.booleans() | st.integers(-(2**60), 2**60) | st.text(), st.lists, max_leaves=20))
def test_clean_json_is_read_as_it_is(value: object) -> None:
    import json

    assert parse(json.dumps({"v": value}).encode()) == {"v": value}


def test_a_clean_order_is_taken(tmp_path: Path) -> None:
    async def send(api: Api) -> None:
        await api.idle()
        assert (await api.client.post(URL, json=ORDER)).status_code == 201

    run_api(tmp_path, send)
