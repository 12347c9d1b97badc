"""Where the files of a guard lie: beside its socket."""

from __future__ import annotations

from pathlib import Path


def ring_beside(socket: Path) -> Path:
    """The ring of samples."""
    return socket.with_suffix(".ring")


def lock_beside(socket: Path) -> Path:
    """Held by the one guard that listens at `socket`."""
    return socket.with_suffix(".lock")
