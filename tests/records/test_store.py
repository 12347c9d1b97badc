import asyncio
import stat
from pathlib import Path

import pytest

from cellctl.records.blobs import Keep, scans_of
from cellctl.records.errors import JournalUnavailable, RecordCorrupt, UnknownRun
from cellctl.records.seal import read_public
from cellctl.records.store import RunStore
from cellctl.records.summary import RunEnded
from cellctl.records.verify import verify
from cellctl.stamps import VirtualStamps
from hal.clock import run_virtual
from tests.records.world import header, small_run

ENDED = RunEnded("Complete", "accepted")


async def stored(data: Path, run_id: str = "run-1", keep: Keep = "all") -> Path:
    run = await RunStore(data).begin(header(run_id), VirtualStamps(1), keep=keep)
    await small_run(run.ledger)
    return await run.end(ENDED)


def test_a_run_from_its_begin_to_its_sealed_record(tmp_path: Path) -> None:
    record = run_virtual(stored(tmp_path))
    store = RunStore(tmp_path)
    assert record == store.record_path("run-1")
    key = read_public((tmp_path / "keys" / "cell_ed25519.pub").read_bytes())
    assert verify(record, key).status == "authentic"
    run = run_virtual(store.get("run-1"))
    assert (run.state, run.verdict) == ("Complete", "accepted")
    assert run_virtual(store.list()) == (run,)
    rows = run_virtual(store.rows("run-1", after=1, limit=2))
    assert [row.seq for row in rows] == [2, 3]
    assert "svg" in run_virtual(store.report("run-1"))
    assert (tmp_path / "runs" / "run-1" / "report.html").read_text() == run_virtual(store.report("run-1"))


def test_the_key_is_the_cells_own_and_readable_by_nobody_else(tmp_path: Path) -> None:
    run_virtual(stored(tmp_path))
    key = tmp_path / "keys" / "cell_ed25519.pem"
    first = key.read_bytes()
    assert stat.S_IMODE(key.stat().st_mode) == 0o600
    run_virtual(stored(tmp_path, "run-2"))
    assert key.read_bytes() == first


@pytest.mark.parametrize(("keep", "blobs"), [("all", 4), ("decision", 2), ("none", 1)])
def test_what_is_kept_follows_the_policy_and_the_journal_does_not(tmp_path: Path, keep: Keep, blobs: int) -> None:
    record = run_virtual(stored(tmp_path, keep=keep))
    assert len(list((tmp_path / "runs" / "run-1" / "blobs").iterdir())) == blobs
    assert verify(record).status == "consistent"
    other = verify(run_virtual(stored(tmp_path / "other")))
    assert verify(record).head == other.head


def test_runs_are_listed_latest_first_in_pages(tmp_path: Path) -> None:
    async def main() -> None:
        for number in range(5):
            await asyncio.sleep(10.0)
            await stored(tmp_path, f"run-{number}")
        store = RunStore(tmp_path)
        assert await store.ids() == ("run-4", "run-3", "run-2", "run-1", "run-0")
        page = await store.list(limit=2, after="run-3")
        assert [run.run_id for run in page] == ["run-2", "run-1"]
        with pytest.raises(UnknownRun):
            await store.list(after="run-9")

    run_virtual(main())


def test_a_running_run_can_be_read_and_has_no_record(tmp_path: Path) -> None:
    async def main() -> None:
        store = RunStore(tmp_path)
        run = await store.begin(header(), VirtualStamps(1))
        await run.ledger.note("phase_scan", None)
        assert (await store.get("run-1")).state == "Running"
        assert (await store.list())[0].state == "Running"
        assert store.record_path("run-1") is None
        await run.end(ENDED)

    run_virtual(main())


def test_after_a_crash_the_run_goes_on_and_open_intents_are_named(tmp_path: Path) -> None:
    async def crash() -> None:
        run = await RunStore(tmp_path).begin(header(), VirtualStamps(1))
        await run.journal.append("intent", {"key": "gun_a-1"})
        await run.journal.close()
        await run.blobs.close()

    async def again() -> tuple[list[str], int]:
        run, unknown = await RunStore(tmp_path).resume("run-1", VirtualStamps(1, start=1))
        await run.end(RunEnded("Aborted", "held", ("crash",)))
        return [intent.value["key"] for intent in unknown], run.journal.count

    run_virtual(crash())
    assert run_virtual(again()) == (["gun_a-1"], 3)


def test_a_run_is_not_written_over_unless_asked(tmp_path: Path) -> None:
    async def again(*, replace: bool) -> int:
        run = await RunStore(tmp_path).begin(header(), VirtualStamps(1), replace=replace)
        await run.end(ENDED)
        return run.journal.count

    run_virtual(stored(tmp_path))
    with pytest.raises(JournalUnavailable, match="run-1"):
        run_virtual(again(replace=False))
    assert run_virtual(again(replace=True)) == 2


def test_no_run_begins_that_the_disk_may_not_hold(tmp_path: Path) -> None:
    store = RunStore(tmp_path, watermark_bytes=1 << 62)
    with pytest.raises(JournalUnavailable, match="MB are free"):
        run_virtual(store.begin(header(), VirtualStamps(1)))
    assert run_virtual(store.ids()) == ()
    run_virtual(stored(tmp_path))


@pytest.mark.parametrize("run_id", ["", "..", "../keys", "a/b", "run-9", "-x", "a" * 81, "run-1\n"])
def test_ids_that_name_no_run(tmp_path: Path, run_id: str) -> None:
    run_virtual(stored(tmp_path))
    store = RunStore(tmp_path)
    with pytest.raises(UnknownRun):
        run_virtual(store.get(run_id))
    with pytest.raises(UnknownRun):
        store.record_path(run_id)


def test_a_blob_is_served_by_its_hash_only(tmp_path: Path) -> None:
    run_virtual(stored(tmp_path))
    store = RunStore(tmp_path)
    rows = run_virtual(store.rows("run-1"))
    digest = next(digest for row in rows for _, digest in scans_of(row))
    assert run_virtual(store.blob("run-1", digest))["points_mm"].shape == (20, 30, 3)
    with pytest.raises(RecordCorrupt):
        run_virtual(store.blob("run-1", "../../keys/cell_ed25519"))


def test_sealing_that_fails_closes_everything_and_is_told(tmp_path: Path) -> None:
    async def main() -> None:
        run = await RunStore(tmp_path).begin(header(), VirtualStamps(1))
        await small_run(run.ledger)
        for path in await asyncio.to_thread(list, (run.folder / "blobs").iterdir()):
            await asyncio.to_thread(path.unlink)
        with pytest.raises(RecordCorrupt, match="missing"):
            await run.end(ENDED)

    asyncio.run(main())
