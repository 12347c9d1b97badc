"""Scans of a run over the API: what was taken, the page of it, and why there is none."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from cellctl.client import CellClient
from cellctl.records.journal import read_rows
from cellctl.records.scans import run_scans
from cellctl.runner import RunRequest, run_once
from tests.api.harness import ORDER, TOKEN, Api, run_api
from tests.journeys.twin_runs import small_recipe, twin_cell


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder of a run on the twin, its decision scans kept."""
    data = tmp_path_factory.mktemp("data")
    outcome = run_once(RunRequest(small_recipe(), twin_cell(), 3, data, keep="decision"))
    assert outcome.record is not None, outcome.reasons
    return outcome.record.parent


@pytest.fixture
def stored(made: Path, tmp_path: Path) -> Path:
    """The same run in a data folder of this test's own."""
    return shutil.copytree(made, tmp_path / "runs" / made.name)


def test_every_scan_is_listed(stored: Path, tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        items = (await api.client.get(f"/api/v1/runs/{stored.name}/scans")).json()["items"]
        assert [item["frame_id"] for item in items] == list(range(1, len(items) + 1))
        assert [item["view"] for item in items[:4]] == ["artefact_rotor", "artefact_shaft", "rotor", "shaft"]
        assert [item["measured"] for item in items[:4]] == [False, False, True, True]
        assert all(item["kept"] and item["refused"] is None for item in items)

    run_api(tmp_path, body, role="viewer")


def test_the_page_of_both_sides_may_do_nothing_here(stored: Path, tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        answer = await api.client.get(f"/api/v1/runs/{stored.name}/scans/page")
        assert answer.status_code == 200
        assert answer.headers["content-type"] == "text/html; charset=utf-8"
        assert answer.headers["content-security-policy"].startswith("sandbox allow-scripts")
        assert int(answer.headers["content-length"]) == len(answer.content) < 3_000_000
        assert answer.text.count('<section class="side"') == 2
        one = await api.client.get(f"/api/v1/runs/{stored.name}/scans/shaft/page?frame_id=4")
        assert "frame 4," in one.text and one.text.count('<section class="side"') == 1

    run_api(tmp_path, body, role="viewer")


def test_the_client_saves_it(stored: Path, tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        async with CellClient("http://cell", TOKEN, transport=api.client._transport) as cell:
            assert (await cell.scans(stored.name)).items[2].view == "rotor"
            await cell.save_scan_page(stored.name, tmp_path / "scans.html")
        assert (tmp_path / "scans.html").read_text().startswith("<!doctype html>")

    run_api(tmp_path, body)


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("scans/rotor/page?frame_id=4", "scan_unknown"),
        ("scans/shaft/page?frame_id=99", "scan_unknown"),
        ("scans/rotor/page", "scan_not_kept"),
        ("scans/page", "scan_not_kept"),
    ],
)
def test_why_there_is_no_page(stored: Path, tmp_path: Path, path: str, code: str) -> None:
    rotor = next(scan for scan in run_scans(read_rows(stored / "journal.sqlite")) if scan.view == "rotor")
    (stored / "blobs" / f"{rotor.blob}.npz").unlink()

    async def body(api: Api) -> None:
        answer = await api.client.get(f"/api/v1/runs/{stored.name}/{path}")
        assert answer.headers["content-type"] == "application/problem+json"
        assert (answer.status_code, answer.json()["code"]) == (404, code)
        items = (await api.client.get(f"/api/v1/runs/{stored.name}/scans")).json()["items"]
        assert [item["kept"] for item in items if item["view"] == "rotor"] == [False]

    run_api(tmp_path, body)


def test_an_order_without_a_journal_has_no_scans(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        assert (await api.client.get(f"/api/v1/runs/{run_id}/scans")).json() == {"items": []}
        for path in ("scans", "scans/page", "scans/rotor/page"):
            unknown = await api.client.get(f"/api/v1/runs/run-none/{path}")
            assert (unknown.status_code, unknown.json()["code"]) == (404, "run_unknown")

    run_api(tmp_path, body)
