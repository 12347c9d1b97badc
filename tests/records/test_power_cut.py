"""Power cuts by file: the tail of the write-ahead log that was not yet acknowledged is dropped or torn."""

import random
import shutil
from pathlib import Path

from cellctl.records.chain import head_of
from cellctl.records.journal import Journal, read_rows
from cellctl.stamps import VirtualStamps
from hal.clock import run_virtual

ROWS = 12


async def written(path: Path, copies: Path) -> list[int]:
    """Size of the log after each acknowledged row; the files as they are before anything is closed."""
    journal = await Journal.open(path, VirtualStamps(1))
    sizes = []
    log = Path(f"{path}-wal")

    def size() -> int:
        return log.stat().st_size

    for number in range(ROWS):
        await journal.append("fact", {"number": number, "text": "x" * random.Random(number).randrange(6000)})
        sizes.append(size())
    shutil.copy(path, copies / "db")
    shutil.copy(log, copies / "wal")
    await journal.close()
    return sizes


def survivors(folder: Path, copies: Path, log: bytes) -> int:
    """Rows that a restarted controller finds, its chain whole and open to further rows."""
    path = folder / "after.sqlite"
    for stale in folder.glob("after*"):
        stale.unlink()
    shutil.copy(copies / "db", path)
    Path(f"{path}-wal").write_bytes(log)

    async def again() -> int:
        journal = await Journal.open(path, VirtualStamps(1, start=1))
        count = journal.count
        await journal.append("fact", "after")
        await journal.close()
        return count

    count = run_virtual(again())
    rows = read_rows(path)
    head_of(rows)
    assert [row.value["number"] for row in rows[:-1]] == list(range(count))
    return count


def test_whatever_happens_to_the_tail_acknowledged_rows_stay(tmp_path: Path) -> None:
    copies, after = tmp_path / "copies", tmp_path / "after"
    copies.mkdir()
    after.mkdir()
    sizes = run_virtual(written(tmp_path / "j.sqlite", copies))
    log = (copies / "wal").read_bytes()
    chance = random.Random(7)
    for acknowledged in range(1, ROWS + 1):
        begin = sizes[acknowledged - 1]
        for _ in range(6):
            cut = chance.randrange(begin, len(log) + 1)
            torn = bytearray(log[:cut])
            for _ in range(chance.randrange(4) if cut > begin else 0):
                torn[chance.randrange(begin, cut)] ^= 1 << chance.randrange(8)
            assert survivors(after, copies, bytes(torn)) >= acknowledged


def test_the_cut_really_bites(tmp_path: Path) -> None:
    copies, after = tmp_path / "copies", tmp_path / "after"
    copies.mkdir()
    after.mkdir()
    sizes = run_virtual(written(tmp_path / "j.sqlite", copies))
    log = (copies / "wal").read_bytes()
    assert survivors(after, copies, log[: sizes[5] - 1]) == 5
    assert survivors(after, copies, log) == ROWS
