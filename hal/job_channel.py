"""How a job crosses to a worker process: a pickle over a socket, its large arrays through shared memory.

Shared memory here is anonymous (`memfd_create`, or an unlinked file): it has no name, so nothing is left behind
however either side dies. Pickle protocol 5 hands out the buffers of every array in an object, however deep it sits;
large ones go through the memory, small ones stay in the pickle.
"""

from __future__ import annotations

import mmap
import os
import pickle
import tempfile
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import NDArray

INLINE_BYTES = 64 * 1024
"""Buffers up to this size stay in the pickle."""
_ALIGN = 64


def shared_file(name: str) -> int:
    """File descriptor of an empty piece of anonymous memory that can be passed to another process."""
    if hasattr(os, "memfd_create"):
        return os.memfd_create(name, os.MFD_CLOEXEC)
    with tempfile.TemporaryFile() as file:
        return os.dup(file.fileno())


def send(connection: Connection, memory: int, value: object) -> None:
    """Send `value`; `memory` is the descriptor that this side writes and the other reads."""
    buffers: list[memoryview] = []

    def out_of_band(buffer: pickle.PickleBuffer) -> bool:
        view = buffer.raw()
        if view.nbytes <= INLINE_BYTES:
            return True
        buffers.append(view)
        return False

    data = pickle.dumps(value, protocol=5, buffer_callback=out_of_band)
    sizes = [view.nbytes for view in buffers]
    total = sum(_padded(size) for size in sizes)
    if total:
        if os.fstat(memory).st_size < total:
            os.ftruncate(memory, total)
        with mmap.mmap(memory, total) as shared:
            place = 0
            for view in buffers:
                _copy(np.frombuffer(view, dtype=np.uint8), shared, place)
                place += _padded(view.nbytes)
    connection.send((data, sizes))


def receive(connection: Connection, memory: int) -> Any:
    """The next value; its arrays are private, writable copies. Raises EOFError when the other side is gone."""
    data, sizes = connection.recv()
    buffers: list[NDArray[np.uint8]] = []
    if sizes:
        with mmap.mmap(memory, sum(_padded(size) for size in sizes), prot=mmap.PROT_READ) as shared:
            place = 0
            for size in sizes:
                buffers.append(np.array(np.frombuffer(shared, np.uint8, size, place)))
                place += _padded(size)
    return pickle.loads(data, buffers=buffers)


@dataclass(frozen=True, slots=True)
class Raised:
    """An exception on its way home. Exceptions whose constructor takes other arguments than `args` do not survive
    pickling by themselves, so class, `args` and attributes travel apart."""

    kind: type[BaseException]
    args: tuple[object, ...]
    attributes: dict[str, object]
    trace: str

    def rebuilt(self) -> BaseException:
        """The exception as it was raised, with the worker's traceback as a note."""
        error = self.kind.__new__(self.kind, *self.args)
        error.args = self.args
        error.__dict__.update(self.attributes)
        error.add_note(self.trace)
        return error


def _copy(source: NDArray[np.uint8], shared: mmap.mmap, place: int) -> None:
    """numpy copies without the interpreter lock, so that an event loop beside goes on."""
    np.frombuffer(shared, np.uint8, source.size, place)[:] = source


def _padded(size: int) -> int:
    return -(-size // _ALIGN) * _ALIGN
