"""Job orders: one key gives one run, one run at a time, what is refused says why."""

from __future__ import annotations

import asyncio
from pathlib import Path
from typing import Any

from cellctl.states import Command, State
from tests.api.harness import ORDER, Api, run_api

URL = "/api/v1/job-orders"


def test_an_order_becomes_a_run_with_a_sealed_record(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        answer = await api.client.post(URL, json=ORDER)
        assert answer.status_code == 201
        order = answer.json()
        assert (order["job_order_id"], order["state"]) == ("JO-1", "Running")
        run_url = f"/api/v1/runs/{order['run_id']}"
        assert (await api.client.get(run_url)).json()["state"] == "Starting"
        await api.services.controller.until(State.EXECUTE)
        assert (await api.client.get(run_url)).json()["state"] == "Execute"
        await api.services.controller.until(State.COMPLETE)
        run = (await api.client.get(run_url)).json()
        assert (run["state"], run["verdict"], run["reasons"], run["sealed"]) == ("Complete", "accepted", [], True)
        assert (await api.client.get(f"{URL}/JO-1")).json()["state"] == "Ended"
        record = await api.client.get(f"{run_url}/record")
        assert record.content[:2] == b"PK"

    run_api(tmp_path, body)


def test_one_key_gives_one_run_and_one_answer(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        key = {"Idempotency-Key": "k-1"}
        together = await asyncio.gather(*(api.client.post(URL, json=ORDER, headers=key) for _ in range(5)))
        await api.services.controller.until(State.COMPLETE)
        late = await api.client.post(URL, json=ORDER, headers=key)
        assert {answer.status_code for answer in [*together, late]} == {201}
        assert len({answer.text for answer in [*together, late]}) == 1
        assert late.headers["Idempotency-Replayed"] == "true"
        assert len(api.sessions) == 1

    run_api(tmp_path, body)


def test_the_same_key_with_another_body_is_refused(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        key = {"Idempotency-Key": "k-1"}
        await api.client.post(URL, json=ORDER, headers=key)
        answer = await api.client.post(URL, json=ORDER | {"job_order_id": "JO-2"}, headers=key)
        assert answer.status_code == 422
        assert answer.json()["code"] == "idempotency_key_reused"

    run_api(tmp_path, body)


def test_a_second_order_waits_in_the_mes(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        await api.client.post(URL, json=ORDER)
        answer = await api.client.post(URL, json=ORDER | {"job_order_id": "JO-2"})
        problem = answer.json()
        assert answer.status_code == 409
        assert answer.headers["content-type"] == "application/problem+json"
        assert (problem["code"], problem["state"]) == ("cell_not_idle", "Starting")
        assert problem["allowed_commands"] == ["hold", "stop", "abort"]
        assert (await api.client.get(f"{URL}/JO-2")).status_code == 404
        again = await api.client.post(URL, json=ORDER)
        assert (again.status_code, again.json()["code"]) == (409, "job_order_exists")

    run_api(tmp_path, body)


def test_a_recipe_that_is_not_there_is_refused(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        answer = await api.client.post(URL, json=ORDER | {"recipe_version": 99})
        assert (answer.status_code, answer.json()["code"]) == (422, "recipe_unknown")
        assert api.services.controller.state is State.IDLE

    run_api(tmp_path, body)


def test_orders_and_keys_outlive_the_service(tmp_path: Path) -> None:
    answers: list[dict[str, Any]] = []
    key = {"Idempotency-Key": "k-1"}

    async def before(api: Api) -> None:
        await api.idle()
        answers.append((await api.client.post(URL, json=ORDER, headers=key)).json())
        await api.services.controller.until(State.COMPLETE)

    async def after(api: Api) -> None:
        answers.append((await api.client.post(URL, json=ORDER, headers=key)).json())
        assert api.sessions == []
        assert (await api.client.get(f"{URL}/JO-1")).json()["state"] == "Ended"
        assert api.services.orders.interrupted() is None

    run_api(tmp_path, before)
    run_api(tmp_path, after)
    assert answers[0] == answers[1]


def test_an_order_that_a_crash_left_open_is_found_again(tmp_path: Path) -> None:
    async def before(api: Api) -> None:
        await api.idle()
        await api.client.post(URL, json=ORDER)
        # What the disk holds when the service is killed now; the torn line was never answered.
        (tmp_path / "copy.jsonl").write_bytes((tmp_path / "orders.jsonl").read_bytes() + b'{"order": {"wan')

    async def after(api: Api) -> None:
        order = api.services.orders.interrupted()
        assert order is not None
        assert order.wanted.job_order_id == "JO-1"
        assert (await api.client.get(f"{URL}/JO-1")).json()["state"] == "Interrupted"

    run_api(tmp_path, before)
    (tmp_path / "copy.jsonl").replace(tmp_path / "orders.jsonl")
    run_api(tmp_path, after)


def test_a_held_order_is_interrupted_and_a_page_of_orders_goes_on(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        for number in range(3):
            await api.idle()
            await api.client.post(URL, json=ORDER | {"job_order_id": f"JO-{number}"})
            await api.services.controller.until(State.EXECUTE)
            if number == 2:
                api.services.controller.request(Command.HOLD)
                await api.services.controller.until(State.HELD)
            else:
                api.services.controller.request(Command.STOP)
                await api.services.controller.until(State.STOPPED)
        first = (await api.client.get(URL, params={"limit": 2})).json()
        assert [(item["job_order_id"], item["state"]) for item in first["items"]] == [
            ("JO-2", "Interrupted"),
            ("JO-1", "Ended"),
        ]
        second = (await api.client.get(URL, params={"limit": 2, "cursor": first["cursor"]})).json()
        assert [item["job_order_id"] for item in second["items"]] == ["JO-0"]
        assert second["cursor"] is None

    run_api(tmp_path, body)
