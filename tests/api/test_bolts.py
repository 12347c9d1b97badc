"""What the page may draw as tight: only what the results prove."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest

from cellctl.api.bolts import bolts_of, recipe_in
from cellctl.recipe import Recipe, load_recipe
from cellctl.states import Command, State
from tests.api.harness import ORDER, ROOT, Api, run_api

ALL = ("snug", "half", "final", "verify")


@pytest.fixture(scope="module")
def recipe() -> Recipe:
    return load_recipe(ROOT / "recipes" / "lpt_shaft_36.toml")


def results(index: int, *stages: str, **verdicts: str) -> list[dict[str, Any]]:
    return [{"index": index, "stage": stage, "verdict": verdicts.get(stage, "ok")} for stage in stages]


def test_only_all_stages_and_the_verification_finish_a_bolt(recipe: Recipe) -> None:
    made = [
        *results(0, *ALL),
        *results(1, "snug"),
        *results(2, "snug", "half", "final"),
        *results(3, "snug", "half", "verify"),
        *results(4, *ALL, final="nok"),
        *results(5, "snug", snug="unknown"),
        *results(6, *ALL, "final"),
        *results(7, "snug", "snug", snug="nok"),
        *results(8, "snug", snug="nok"),
        *results(8, "snug"),
    ]
    bolts = bolts_of(recipe, made)
    assert [bolt.index for bolt in bolts] == list(range(36))
    states = ["ok", "partial", "partial", "partial", "nok", "unknown", "partial", "nok", "nok"]
    assert [bolt.state for bolt in bolts] == states + ["open"] * 27


def test_bolts_sit_where_the_recipe_puts_them(recipe: Recipe) -> None:
    pattern = recipe.pattern.model_copy(update={"count": 3, "angles_deg": (0.0, 100.0, 250.0)})
    bolts = bolts_of(recipe.model_copy(update={"pattern": pattern}), [])
    assert [bolt.angle_deg for bolt in bolts] == [0.0, 100.0, 250.0]
    assert [bolt.angle_deg for bolt in bolts_of(recipe, [])][:3] == [0.0, 10.0, 20.0]


def test_the_recipe_of_the_header_is_read_or_nothing_is_known(recipe: Recipe) -> None:
    assert recipe_in({"recipe": recipe.model_dump(mode="json")}) == recipe
    wrong: tuple[object, ...] = (None, [], {}, {"recipe": None}, {"recipe": {"pattern": {"count": 36}}})
    assert [recipe_in(header) for header in wrong] == [None] * len(wrong)


def test_bolts_that_are_only_snug_are_not_finished_by_the_end_of_the_run(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        await api.services.controller.until(State.EXECUTE)
        api.services.controller.request(Command.STOP)
        await api.services.controller.until(State.STOPPED)
        run = (await api.client.get(f"/api/v1/runs/{run_id}")).json()
        assert (run["state"], run["verdict"]) == ("Stopped", "held")
        bolts = (await api.client.get(f"/api/v1/runs/{run_id}/joints")).json()["bolts"]
        assert [bolt["state"] for bolt in bolts] == ["partial"] * 2 + ["open"] * 34

    run_api(tmp_path, body)


def test_a_result_without_numbers_is_told(tmp_path: Path) -> None:
    async def body(api: Api) -> None:
        await api.idle()
        run_id = (await api.client.post("/api/v1/job-orders", json=ORDER)).json()["run_id"]
        await api.services.controller.until(State.EXECUTE)
        opened = api.sessions[0].opened
        assert opened is not None
        lost = {"index": 9, "gun": "a", "stage": "snug", "torque_nm": math.nan, "angle_deg": math.nan}
        await opened.ledger.note("joint", lost | {"verdict": "unknown"})
        answer = await api.client.get(f"/api/v1/runs/{run_id}/joints")
        assert answer.status_code == 200
        (told,) = [item for item in answer.json()["items"] if item["index"] == 9]
        assert (told["torque_nm"], told["angle_deg"], told["verdict"]) == (None, None, "unknown")
        assert answer.json()["bolts"][9] == {"index": 9, "angle_deg": 90.0, "state": "unknown"}

    run_api(tmp_path, body)
