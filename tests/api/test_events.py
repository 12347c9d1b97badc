"""The event stream: no gap, replay, an end that does not hold up the service."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from typing import Any

from cellctl.event_log import EventLog
from cellctl.states import State
from hal.clock import run_virtual
from tests.api.harness import ORDER, Api, run_api
from tests.doubles import virtual_now


def parsed(text: str) -> list[dict[str, Any]]:
    """The events of a stream, comments left out; an event without id carries none."""
    found = []
    for block in text.replace("\r\n", "\n").split("\n\n"):
        fields = dict(line.split(": ", 1) for line in block.split("\n") if ": " in line and not line.startswith(":"))
        if "data" in fields:
            found.append(fields | {"data": json.loads(fields["data"])})
    return found


def sequence_of(event: dict[str, Any]) -> int:
    """The number in an event's id, which is the one in its data."""
    found = int(event["id"].rpartition("-")[2])
    assert found == event["data"]["sequence"]
    return found


def test_a_whole_run_is_told_without_a_gap(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        stream = asyncio.create_task(api.client.get("/api/v1/events", headers={"Last-Event-ID": "0"}))
        await asyncio.sleep(0)
        await api.idle()
        await api.client.post("/api/v1/job-orders", json=ORDER)
        await api.services.controller.until(State.COMPLETE)
        await asyncio.sleep(0.1)
        api.services.events.close()
        events = parsed((await stream).text)
        assert [sequence_of(event) for event in events] == list(range(1, api.services.events.last + 1))
        states = [event["data"]["data"]["state"] for event in events if event["event"] == "state"]
        assert states == ["Resetting", "Idle", "Starting", "Execute", "Completing", "Complete"]
        assert [event["event"] for event in events][-1] in ("state", "run_ended")
        phases = [event["data"]["data"]["phase"] for event in events if event["event"] == "progress"]
        assert phases == ["scan", "align", "jack_up", "heat", "tighten"]

    run_api(tmp_path, body)


def test_replay_goes_on_behind_the_last_event(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        for number in range(10):
            api.services.events.publish("note", {"number": number})
        last = api.services.events.last
        api.services.events.close()
        replayed = await api.client.get("/api/v1/events", headers={"Last-Event-ID": str(last - 3)})
        assert [sequence_of(event) for event in parsed(replayed.text)] == [last - 2, last - 1, last]
        same = await api.client.get("/api/v1/events", params={"after": last - 3})
        assert parsed(same.text) == parsed(replayed.text)
        only_new = await api.client.get("/api/v1/events")
        assert parsed(only_new.text) == []

    run_api(tmp_path, body)


def test_a_number_from_before_a_restart_is_told_as_a_gap(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        api.services.events.close()
        events = parsed((await api.client.get("/api/v1/events", headers={"Last-Event-ID": "5000"})).text)
        assert events[0]["event"] == "gap"
        assert "id" not in events[0]
        assert [sequence_of(event) for event in events[1:]] == [1, 2]

    run_api(tmp_path, body)


def test_an_id_is_replayed_in_its_own_boot_and_a_gap_in_any_other(tmp_path: Path) -> None:
    async def told_after(api: Api, event_id: str) -> list[dict[str, Any]]:
        answer = await api.client.get("/api/v1/events", headers={"Last-Event-ID": event_id})
        return parsed(answer.text)

    async def body(api: Api) -> None:
        await api.idle()
        cell = (await api.client.get("/api/v1/cell")).json()
        api.services.events.publish("note", {})
        api.services.events.close()
        boot, _, last = cell["event_id"].partition("-")
        assert (boot, int(last)) == (api.services.events.boot, cell["event_sequence"])
        (note,) = await told_after(api, cell["event_id"])
        assert (note["event"], note["id"]) == ("note", f"{boot}-{int(last) + 1}")
        assert await told_after(api, note["id"]) == []
        for other in (f"{int(boot) - 1}-{last}", f"{int(boot) - 1}-1", f"{boot}-{int(last) + 2}"):
            events = await told_after(api, other)
            assert events[0]["event"] == "gap"
            assert [sequence_of(event) for event in events[1:]] == list(range(1, int(last) + 2))

    run_api(tmp_path, body)


def test_a_log_that_was_made_later_has_another_boot() -> None:
    async def main() -> None:
        before = EventLog(virtual_now)
        await asyncio.sleep(0.001)
        assert EventLog(virtual_now).boot != before.boot

    run_virtual(main())


def test_a_wrong_last_event_id_is_refused(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        for wrong in ("-1", "x", "1" * 40, "1-", "1-2-3", "1-x", "+1"):
            answer = await api.client.get("/api/v1/events", headers={"Last-Event-ID": wrong})
            assert answer.status_code == 422

    run_api(tmp_path, body)


def test_the_log_forgets_the_oldest_and_readers_see_the_rest_in_order() -> None:
    async def main() -> None:
        log = EventLog(virtual_now, keep=5)
        for number in range(12):
            log.publish("note", {"number": number})
        assert (log.first, log.last) == (8, 12)
        assert [event.sequence for event in log.since(0)] == [8, 9, 10, 11, 12]
        assert [event.sequence for event in log.since(10)] == [11, 12]
        assert log.since(99) == []

        async def read() -> list[int]:
            return [event.sequence async for event in log.follow(10)]

        readers = [asyncio.create_task(read()) for _ in range(3)]
        for _ in range(4):
            await asyncio.sleep(0.1)
            log.publish("note", {})
        await asyncio.sleep(0.1)
        log.close()
        assert await asyncio.gather(*readers) == [[11, 12, 13, 14, 15, 16]] * 3

    run_virtual(main())
