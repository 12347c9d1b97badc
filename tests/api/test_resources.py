"""Runs, recipes, dry runs, health, metrics and the page."""

from __future__ import annotations

import asyncio
import itertools
import re
from pathlib import Path

from prometheus_client.parser import text_string_to_metric_families

from cellctl.api.schemas import Cell
from cellctl.states import State
from tests.api.harness import ORDER, Api, run_api


async def one_run(api: Api) -> str:
    """A whole run; its id."""
    await api.idle()
    run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
    await api.services.controller.until(State.COMPLETE)
    return str(run_id)


def test_a_run_can_be_read_row_by_row(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        run_id = await one_run(api)
        seen = []
        cursor: int | None = 0
        while cursor is not None:
            page = (await api.client.get(f"/api/v1/runs/{run_id}/journal?limit=2&cursor={cursor}")).json()
            seen += page["items"]
            cursor = page["cursor"]
        assert [row["seq"] for row in seen] == list(range(1, len(seen) + 1))
        assert all(row["prev"] == before["hash"] for before, row in itertools.pairwise(seen))
        run = (await api.client.get(f"/api/v1/runs/{run_id}")).json()
        assert run["journal_hash"] == seen[-1]["hash"]
        assert run["serials"] == {"rotor": "R-1", "shaft": "S-1"}
        joints = (await api.client.get(f"/api/v1/runs/{run_id}/joints")).json()
        assert joints["count"] == 36
        assert [joint["index"] for joint in joints["items"]] == [0, 1]
        assert all(joint["simulated"] for joint in joints["items"])
        report = await api.client.get(f"/api/v1/runs/{run_id}/report")
        assert report.headers["content-type"].startswith("text/html")
        assert run_id in report.text

    run_api(tmp_path, body)


def test_runs_are_listed_newest_first(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        ids = []
        for number in range(3):
            await api.idle()
            order = ORDER | {"job_order_id": f"JO-{number}"}
            ids.append((await api.client.post("/api/v1/job-orders", json=order)).json()["run_id"])
            await api.services.controller.until(State.COMPLETE)
        first = (await api.client.get("/api/v1/runs?limit=2")).json()
        second = (await api.client.get(f"/api/v1/runs?limit=2&cursor={first['cursor']}")).json()
        assert [run["run_id"] for run in first["items"] + second["items"]] == ids[::-1]
        assert second["cursor"] is None

    run_api(tmp_path, body)


def test_a_run_without_a_journal_yet_is_known(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        joints = (await api.client.get(f"/api/v1/runs/{run_id}/joints")).json()
        assert joints == {"count": None, "items": [], "bolts": []}
        run = (await api.client.get(f"/api/v1/runs/{run_id}")).json()
        assert (run["state"], run["verdict"]) == ("Starting", None)
        record = await api.client.get(f"/api/v1/runs/{run_id}/record")
        assert (record.status_code, record.json()["code"]) == (404, "record_not_sealed")
        unknown = await api.client.get("/api/v1/runs/run-none/record")
        assert (unknown.status_code, unknown.json()["code"]) == (404, "run_unknown")

    run_api(tmp_path, body)


def test_recipes_carry_their_hash_as_etag(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        listed = (await api.client.get("/api/v1/recipes")).json()["items"]
        entry = next(item for item in listed if item["id"] == "lpt_shaft_36")
        url = f"/api/v1/recipes/lpt_shaft_36/versions/{entry['version']}"
        answer = await api.client.get(url)
        assert answer.json()["pattern"]["count"] == 36
        assert answer.headers["etag"] == f'"{entry["content_hash"]}"'
        again = await api.client.get(url, headers={"If-None-Match": answer.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")

    run_api(tmp_path, body)


def test_one_dry_run_at_a_time(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        asked = {"recipe": "lpt_shaft_36", "recipe_version": 1, "seed": 7}
        begun = await api.client.post("/api/v1/dry-runs", json=asked)
        assert (begun.status_code, begun.json()["state"]) == (202, "Running")
        busy = await api.client.post("/api/v1/dry-runs", json=asked)
        assert (busy.status_code, busy.json()["code"]) == (409, "dry_run_busy")
        await asyncio.sleep(5)
        ended = (await api.client.get(f"/api/v1/dry-runs/{begun.json()['dry_run_id']}")).json()
        assert (ended["state"], ended["verdict"], ended["seed"], ended["cell_time_s"]) == ("Ended", "accepted", 7, 2400)
        failed = (await api.client.post("/api/v1/dry-runs", json=asked | {"seed": 13})).json()
        await asyncio.sleep(5)
        items = (await api.client.get("/api/v1/dry-runs")).json()["items"]
        assert [(item["dry_run_id"], item["state"]) for item in items] == [
            (failed["dry_run_id"], "Failed"),
            (begun.json()["dry_run_id"], "Ended"),
        ]
        assert items[0]["reasons"] == ["the twin was refused"]

    run_api(tmp_path, body)


def test_readiness_says_why_not(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        assert (await api.client.get("/health/ready")).json() == {"status": "ready", "reason": ""}
        object.__setattr__(api.services, "not_ready", lambda: "the scanner is not connected")
        answer = await api.client.get("/api/v1/health/ready")
        assert (answer.status_code, answer.json()["reason"]) == (503, "the scanner is not connected")

    run_api(tmp_path, body)


def test_metrics_are_prometheus_text(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.client.post("/api/v1/cell/commands", json={"command": "hold"})
        text = (await api.client.get("/api/v1/metrics")).text
        samples = {
            (sample.name, *sorted(sample.labels.values())): sample.value
            for family in text_string_to_metric_families(text)
            for sample in family.samples
        }
        assert samples["cellctl_state", "Stopped"] == 1.0
        assert samples["cellctl_state", "Idle"] == 0.0
        assert samples["cellctl_commands_total", "false", "hold"] == 1.0

    run_api(tmp_path, body)


def test_the_page_needs_nothing_from_outside(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        index = await api.client.get("/")
        assert index.status_code == 200
        assert "default-src 'none'" in index.headers["content-security-policy"]
        for name in ("page.css", "page.js", "api.js", "bolts.js", "icon.svg"):
            file = await api.client.get(f"/page/{name}")
            assert file.status_code == 200
            outside = file.text.replace("http://www.w3.org/2000/svg", "")
            assert "http://" not in outside
            assert "https://" not in outside
        assert "http" not in index.text
        assert index.text.count("not the emergency stop") == 2

    run_api(tmp_path, body, role="")


def test_the_page_shows_what_the_cell_says_is_wrong(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        index = (await api.client.get("/")).text
        script = (await api.client.get("/page/page.js")).text
        places = set(re.findall(r'by\("([a-z-]+)"\)', script))
        assert len(places) > 15
        assert [place for place in places if f'id="{place}"' not in index] == []
        shown = set(re.findall(r"\bcell\.([a-z_]+)", script))
        wanted = {"why", "alarms", "unsafe_devices", "allowed_commands", "simulated", "state"}
        assert wanted <= shown <= set(Cell.model_fields)

    run_api(tmp_path, body, role="")


def test_a_run_that_never_got_a_journal_says_why(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        (tmp_path / "runs").write_text("a file where the folder should be")
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        await api.services.controller.until(State.STOPPED)
        run = (await api.client.get(f"/api/v1/runs/{run_id}")).json()
        assert (run["state"], run["verdict"], run["sealed"]) == ("Stopped", "held", False)
        assert "cannot be begun" in run["reasons"][0]

    run_api(tmp_path, body)
