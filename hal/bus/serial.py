"""One serial port in the running event loop, by pyserial: no thread, no task. Paths are devices or pseudo-terminals."""

from __future__ import annotations

import asyncio
import contextlib
import os
import stat
from collections.abc import Callable
from pathlib import Path

import serial

READ = 65536
LATENCY_MS = 1


class SerialLine:
    """An open port, in exclusive use. Bytes go to `on_bytes` as they come; `on_lost` hears once that the port is gone.

    Errors are OSError: the port cannot be opened (absent, in use, no rights) or its latency not be set.
    """

    def __init__(
        self,
        path: str,
        baud: int,
        on_bytes: Callable[[bytes], None],
        on_lost: Callable[[str], None],
        *,
        parity: str = "N",
        sys_root: Path = Path("/sys"),
    ) -> None:
        # Only a terminal: another file would be read to its end and taken for a stream.
        if not stat.S_ISCHR(Path(path).stat().st_mode):
            raise OSError(f"{path} is no serial port")
        self.latency_ms = set_latency(path, sys_root)
        """As read back; None where the port has no such timer."""
        self._on_bytes = on_bytes
        self._on_lost = on_lost
        self._loop = asyncio.get_running_loop()
        try:
            self._port = serial.Serial(path, baud, parity=parity, timeout=0, write_timeout=0, exclusive=True)
        except ValueError as error:  # a baud rate that the port does not know
            raise OSError(str(error)) from None
        self._fd = self._port.fileno()
        self._port.reset_input_buffer()  # what was sent to somebody before
        self._loop.add_reader(self._fd, self._read)

    @property
    def is_open(self) -> bool:
        """False once closed or lost."""
        return bool(self._port.is_open)

    def write(self, data: bytes) -> None:
        """Send. Raises OSError when the port is gone or takes nothing."""
        if not self.is_open:
            raise OSError("the port is closed")
        written = os.write(self._fd, data)
        if written < len(data):
            raise OSError(f"the port took {written} of {len(data)} bytes")

    def close(self) -> None:
        """Give the port back; nothing is heard any more."""
        if self.is_open:
            self._loop.remove_reader(self._fd)
            with contextlib.suppress(OSError):
                self._port.close()

    def _read(self) -> None:
        try:
            data = os.read(self._fd, READ)
        except BlockingIOError:
            return
        except OSError as error:
            self._lose(error.strerror or str(error))
            return
        if data:
            self._on_bytes(data)
        else:  # readable without data: the adapter was unplugged
            self._lose("hung up")

    def _lose(self, reason: str) -> None:
        self.close()
        self._on_lost(reason)


def set_latency(path: str, sys_root: Path = Path("/sys")) -> int | None:
    """Set the latency timer of a USB adapter (16 ms by default) to 1 ms and read it back; None where it has none.

    Raises OSError where it stays at something else.
    """
    timer = sys_root / "bus/usb-serial/devices" / Path(path).resolve().name / "latency_timer"
    if not timer.exists():
        return None
    if _milliseconds(timer) != LATENCY_MS:
        with contextlib.suppress(OSError):
            timer.write_text(str(LATENCY_MS), encoding="ascii")
    if (found := _milliseconds(timer)) != LATENCY_MS:
        raise OSError(f"{timer}: {found} ms, and it cannot be set to {LATENCY_MS} ms (a udev rule must give the right)")
    return found


def _milliseconds(timer: Path) -> int:
    try:
        return int(timer.read_text(encoding="ascii"))
    except ValueError as error:
        raise OSError(f"{timer}: {error}") from None
