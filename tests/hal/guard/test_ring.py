"""Samples in shared memory: numbered, whole, and noticed where they are not."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from hal.guard.ring import SIZE, SLOTS, RingError, RingReader, RingWriter


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "ring"


def put(ring: RingWriter, first: int, count: int) -> None:
    numbers = np.arange(first, first + count, dtype=np.float64)
    ring.put(first, numbers * 1e-3, numbers * 10.0)


def test_a_reader_gets_what_was_written(path: Path) -> None:
    writer = RingWriter(path)
    reader = RingReader(path)
    assert len(reader.take(0, 10)[1]) == 0, "slots never written hold no samples"
    put(writer, 0, 7)
    first, times, forces = reader.take(2, 10)
    assert (first, len(forces)) == (2, 5)
    np.testing.assert_array_equal(times, np.arange(2, 7) * 1e-3)
    np.testing.assert_array_equal(forces, np.arange(2, 7) * 10.0)
    assert len(reader.take(7, 1)[1]) == 0
    reader.close()
    writer.close()
    assert not path.exists()


def test_the_oldest_are_written_over(path: Path) -> None:
    writer, reader = RingWriter(path), RingReader(path)
    for first in range(0, 3 * SLOTS, 1000):
        put(writer, first, 1000)
    first, _, forces = reader.take(0, 5)
    assert first == reader.next - SLOTS
    np.testing.assert_array_equal(forces, np.arange(first, first + 5) * 10.0)
    put(writer, reader.next, 2 * SLOTS)
    assert len(reader.take(0, SLOTS)[2]) == SLOTS
    reader.close()
    writer.close()


def test_missing_samples_end_what_is_taken(path: Path) -> None:
    writer, reader = RingWriter(path), RingReader(path)
    put(writer, 0, 10)
    put(writer, 15, 10)
    assert [reader.take(0, 100)[0], len(reader.take(0, 100)[2])] == [0, 10]
    first, _, forces = reader.take(10, 100)
    assert (first, len(forces)) == (15, 10)
    reader.close()
    writer.close()


@pytest.mark.parametrize("place", range(4))
def test_a_torn_slot_is_no_sample(path: Path, place: int) -> None:
    """Whichever of its four words is another one's."""
    writer, reader = RingWriter(path), RingReader(path)
    put(writer, 0, 10)
    with path.open("r+b") as file:
        file.seek(SIZE - 32 * SLOTS + 4 * 32 + 8 * place)
        file.write(b"\x55" * 8)
    assert len(reader.take(0, 10)[2]) == 4
    assert reader.take(4, 10)[0] == 5
    reader.close()
    writer.close()


def test_a_sample_that_is_not_a_number_is_kept(path: Path) -> None:
    writer, reader = RingWriter(path), RingReader(path)
    writer.put(3, np.array([0.1, 0.2]), np.array([np.nan, np.inf]))
    assert reader.take(0, 10)[0] == 3
    np.testing.assert_array_equal(reader.take(3, 2)[2], [np.nan, np.inf])
    reader.close()
    writer.close()


def test_what_is_no_ring_is_refused(path: Path) -> None:
    with pytest.raises(OSError, match="ring"):
        RingReader(path)
    path.write_bytes(b"short")
    with pytest.raises(RingError, match="ring"):
        RingReader(path)
    path.write_bytes(bytes(SIZE))
    with pytest.raises(RingError, match="no ring of samples"):
        RingReader(path)
