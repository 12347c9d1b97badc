"""The cell's resource and its commands."""

from __future__ import annotations

from pathlib import Path

from cellctl.states import State
from tests.api.harness import ORDER, Api, run_api

CELL = "/api/v1/cell"
COMMANDS = "/api/v1/cell/commands"


def test_the_cell_says_what_it_does_and_what_it_allows(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        cell = (await api.client.get(CELL)).json()
        assert (cell["state"], cell["allowed_commands"], cell["run_id"]) == ("Stopped", ["reset", "abort"], None)
        assert cell["progress"]["time_left_s"] is None
        taken = await api.client.post(COMMANDS, json={"command": "reset"})
        assert (taken.status_code, taken.json()["state"]) == (202, "Resetting")
        await api.services.controller.until(State.IDLE)
        await api.client.post("/api/v1/job-orders", json=ORDER)
        await api.services.controller.until(State.EXECUTE)
        cell = (await api.client.get(CELL)).json()
        assert cell["job_order_id"] == "JO-1"
        assert cell["progress"]["time_left_s"] == 60.0
        assert cell["event_sequence"] == api.services.events.last

    run_api(tmp_path, body)


def test_a_wrong_command_is_a_conflict_that_names_the_allowed_ones(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        for command in ("unhold", "hold", "start", "complete", "clear", "stop"):
            answer = await api.client.post(COMMANDS, json={"command": command})
            assert answer.status_code == 409, command
            assert answer.json()["allowed_commands"] == ["reset", "abort"]
            assert answer.json()["state"] == "Stopped"

    run_api(tmp_path, body)


def test_hold_and_unhold_over_the_api(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        await api.client.post("/api/v1/job-orders", json=ORDER)
        await api.services.controller.until(State.EXECUTE)
        held = await api.client.post(COMMANDS, json={"command": "hold", "reason": "a look at the studs"})
        assert held.json()["state"] == "Holding"
        await api.services.controller.until(State.HELD)
        cell = (await api.client.get(CELL)).json()
        assert "a look at the studs" in cell["why"]
        assert "unhold" in cell["allowed_commands"]
        await api.client.post(COMMANDS, json={"command": "unhold"})
        assert await api.services.controller.until(State.COMPLETE) is State.COMPLETE

    run_api(tmp_path, body)


def test_stop_over_the_api_halts_and_leaves_a_sealed_record(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        await api.services.controller.until(State.EXECUTE)
        assert (await api.client.post(COMMANDS, json={"command": "stop"})).status_code == 202
        await api.services.controller.until(State.STOPPED)
        run = (await api.client.get(f"/api/v1/runs/{run_id}")).json()
        assert (run["state"], run["verdict"], run["sealed"]) == ("Stopped", "held", True)
        assert "demo-admin" in run["reasons"][0]

    run_api(tmp_path, body)


def test_a_device_that_is_not_safe_is_named(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        api.cell.hung.add("heater")
        await api.client.post(COMMANDS, json={"command": "abort"})
        await api.services.controller.until(State.ABORTED)
        cell = (await api.client.get(CELL)).json()
        assert cell["unsafe_devices"] == [{"device": "heater", "reason": "no answer to halt"}]
        assert [alarm["code"] for alarm in cell["alarms"]] == ["not_safe"]

    run_api(tmp_path, body)
