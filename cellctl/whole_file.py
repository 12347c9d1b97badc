"""Files that a reader finds as they were before or as they are now, never a part of either. Blocking."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO


@contextlib.contextmanager
def whole_file(path: Path, *, durable: bool = True, mode: int | None = None) -> Iterator[BinaryIO]:
    """What is written goes beside `path` and takes its place at the end; what fails leaves `path` and its folder as
    they were.

    `durable`: file and name have reached the disk when this returns. `mode` are the permissions, whatever the umask.
    Raises OSError.
    """
    part = path.with_suffix(".part")
    part.unlink(missing_ok=True)  # of a writer that died
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL
    try:
        with os.fdopen(os.open(part, flags, 0o666 if mode is None else mode), "wb") as file:
            if mode is not None:
                os.fchmod(file.fileno(), mode)
            yield file
            if durable:
                file.flush()
                os.fsync(file.fileno())
        part.replace(path)
    except BaseException:
        part.unlink(missing_ok=True)
        raise
    if durable:
        sync_folder(path.parent)


def sync_folder(folder: Path) -> None:
    """Make a rename in `folder` durable."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
