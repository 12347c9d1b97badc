import asyncio
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from cellctl.records.audit import blob_hashes
from cellctl.records.blobs import load
from cellctl.records.errors import JournalUnavailable
from cellctl.records.journal import open_intents
from hal.clock import run_virtual
from hal.errors import GuardTripped, UnknownOutcome
from hal.interfaces import AxisState, Frame
from tests.records.world import Desk, desk

STATE = AxisState(position=2.0, velocity=0.0, homed=True, enabled=True, brake_closed=False, moving=False, time_s=3.0)


async def story(at: Desk) -> list[tuple[str, dict]]:
    rows = await at.journal.rows()
    return [(row.kind, row.value) for row in rows]


def test_intent_is_durable_before_the_command_and_result_before_the_answer() -> None:
    async def main() -> None:
        at = await desk()
        seen: list[str] = []

        async def do(key: str) -> AxisState:
            rows = await at.journal.rows()
            assert [(row.kind, row.value["key"]) for row in rows] == [("intent", key)]
            seen.append(key)
            await asyncio.sleep(3.0)
            return STATE

        assert await at.ledger.act("jack", "move_to", {"position": 2.0, "speed": 1.0}, do) is STATE
        (_, intent), (kind, result) = await story(at)
        assert kind == "result"
        assert intent == {
            "key": seen[0], "device": "jack", "command": "move_to", "arguments": {"position": 2.0, "speed": 1.0}
        }  # fmt: skip
        assert result["result"]["position"] == 2.0
        assert result["key"] == seen[0]
        assert at.journal.count == 2
        await at.close()

    run_virtual(main())


@pytest.mark.parametrize(
    ("error", "code"),
    [
        (UnknownOutcome("no answer", device="gun_a"), "outcome_unknown"),
        (GuardTripped("over-force", force_n=12.0), "guard_tripped"),
        (ZeroDivisionError("oops"), "unexpected"),
    ],
)
def test_errors_are_written_and_passed_on(error: Exception, code: str) -> None:
    async def main() -> None:
        at = await desk()

        async def do(key: str) -> None:
            raise error

        with pytest.raises(type(error)) as caught:
            await at.ledger.act("gun_a", "tighten", {}, do)
        assert caught.value is error
        kinds = await story(at)
        assert [kind for kind, _ in kinds] == ["intent", "error"]
        assert kinds[1][1]["code"] == code
        assert open_intents(await at.journal.rows()) == ()
        await at.close()

    run_virtual(main())


def test_a_cancelled_command_is_written_as_unknown_and_stays_cancelled() -> None:
    async def main() -> None:
        at = await desk()

        async def do(key: str) -> None:
            await asyncio.sleep(100.0)

        task = asyncio.create_task(at.ledger.act("jack", "move_to", {}, do))
        await asyncio.sleep(1.0)
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        kinds = await story(at)
        assert [(kind, value.get("outcome")) for kind, value in kinds] == [("intent", None), ("cancelled", "unknown")]
        await at.close()

    run_virtual(main())


def test_cancelled_before_it_was_sent_it_is_not_sent(tmp_path: Path) -> None:
    async def main() -> None:
        at = await desk(tmp_path)
        sent: list[str] = []

        async def do(key: str) -> None:
            sent.append(key)

        task = asyncio.create_task(at.ledger.act("jack", "move_to", {}, do))
        await asyncio.sleep(0)  # begun, its intent is on the way to the disk
        task.cancel()
        with pytest.raises(asyncio.CancelledError):
            await task
        kinds = await story(at)
        assert sent == []
        assert [(kind, value.get("outcome")) for kind, value in kinds] in (
            [],
            [("intent", None), ("cancelled", "not_sent")],
        )
        await at.close()

    asyncio.run(main())


def test_a_result_that_came_is_written_though_its_caller_is_cancelled(tmp_path: Path) -> None:
    async def main() -> None:
        at = await desk(tmp_path)

        async def do(key: str) -> dict[str, object]:
            running.cancel()  # arrives at the next await: while the result is being written
            return {"trace": np.zeros(5000)}

        running = asyncio.create_task(at.ledger.act("gun_a", "tighten", {}, do))
        with pytest.raises(asyncio.CancelledError):
            await running
        assert [kind for kind, _ in await story(at)] == ["intent", "result"]
        await at.close()

    asyncio.run(main())


def test_without_a_durable_intent_nothing_is_sent() -> None:
    async def main() -> None:
        at = await desk()
        sent: list[str] = []

        async def do(key: str) -> None:
            sent.append(key)

        at.journal._database.execute("PRAGMA query_only=ON")
        with pytest.raises(JournalUnavailable):
            await at.ledger.act("jack", "move_to", {}, do)
        assert sent == []
        await at.close()

    run_virtual(main())


def test_a_result_that_cannot_be_written_is_not_acknowledged() -> None:
    async def main() -> None:
        at = await desk()

        async def do(key: str) -> str:
            at.journal._database.execute("PRAGMA query_only=ON")
            return "done"

        with pytest.raises(JournalUnavailable):
            await at.ledger.act("jack", "move_to", {}, do)
        assert len(open_intents(await at.journal.rows())) == 1
        await at.close()

    run_virtual(main())


def test_a_frame_goes_to_the_blobs_under_the_hash_that_the_scan_has(tmp_path: Path) -> None:
    async def main() -> tuple[str, str, frozenset[str]]:
        at = await desk(tmp_path)
        points = np.ones((30, 40, 3), dtype=np.float32)

        async def do(key: str) -> Frame:
            return Frame(1, "rotor", 0.0, points)

        await at.ledger.act("scanner", "capture", {"view": "rotor"}, do)
        digest = await at.ledger.blob("scan_rotor", {"points_mm": points})
        rows = await at.journal.rows()
        await at.close()
        return rows[1].value["result"]["points_mm"]["blob"], digest, blob_hashes(rows)

    named, digest, hashes = run_virtual(main())
    assert named == digest
    assert hashes == {digest}
    assert load(tmp_path / "blobs", digest)["points_mm"].shape == (30, 40, 3)


@dataclass(frozen=True)
class Insertion:
    peak_total_n: float
    clearance_mm: np.ndarray


def test_a_note_carries_the_name_of_its_class_and_small_arrays() -> None:
    async def main() -> list[tuple[str, dict]]:
        at = await desk()
        await at.ledger.note("phase_jack_up", Insertion(float("nan"), np.array([0.1, 0.2])))
        await at.ledger.note("phase_scan", None)
        kinds = await story(at)
        await at.close()
        return kinds

    assert run_virtual(main()) == [
        ("phase_jack_up", {"$type": "Insertion", "peak_total_n": "NaN", "clearance_mm": [0.1, 0.2]}),
        ("phase_scan", None),
    ]


def test_two_guns_at_once_keep_their_keys_apart() -> None:
    async def main() -> list[tuple[str, str]]:
        at = await desk()

        async def do(key: str) -> str:
            await asyncio.sleep(1.0)
            return key

        guns = ("gun_a", "gun_b")
        keys = await asyncio.gather(*(at.ledger.act(gun, "tighten", {}, do) for gun in guns))
        rows = await at.journal.rows()
        await at.close()
        assert [row.value["result"] for row in rows if row.kind == "result"] == list(keys)
        return [(row.kind, row.value["device"]) for row in rows]

    assert run_virtual(main()) == [
        ("intent", "gun_a"), ("intent", "gun_b"), ("result", "gun_a"), ("result", "gun_b")
    ]  # fmt: skip
