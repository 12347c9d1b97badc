"""A recorded bus as a file: JSON lines, the first about the bus, each other one piece of what passed on it.

::

    {"capture": 1, "cell": "wire-cell", "bus": "open_protocol 127.0.0.1:4545", "kind": "open_protocol",
     "devices": ["gun_a"], "started": "2026-01-31T09:00:00.000Z"}
    {"t": 0.4021, "link": 1, "event": "opened"}
    {"t": 0.4025, "link": 1, "dir": "out", "text": "00200001004         \\u0000"}
    {"t": 0.4031, "link": 1, "dir": "in", "hex": "ff00"}
    {"t": 0.5000, "link": 0, "dir": "out", "id": "603", "hex": "4041600000000000"}

`t` is seconds since the start; `out` goes from the controller to the device, `in` comes from it. Bytes stand as `text`
where a person can read all of them, otherwise as `hex`; on a stream they are pieces as they came, whose borders mean
nothing. `id` is a CAN identifier in hex, with one frame a line. `link` counts the connections of a stream; an `event`
is said of one of them.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, TextIO, get_args

from hal.errors import ConfigError

VERSION = 1
READABLE = bytes(range(0x20, 0x7F)) + b"\r\n\0"
Direction = Literal["out", "in"]


@dataclass(frozen=True, slots=True)
class Header:
    """What was recorded; `kind` is that of the devices' entries in the cell file."""

    cell: str
    bus: str
    kind: str
    devices: tuple[str, ...]
    started: str


@dataclass(frozen=True, slots=True)
class Record:
    """One piece of bytes, or one `event` without any. `line` is its place in the file, 0 where it is not from one."""

    time_s: float
    direction: Direction = "in"
    data: bytes = b""
    can_id: int | None = None
    link: int = 0
    event: str = ""
    line: int = field(default=0, compare=False)


class CaptureFile:
    """Written line by line, so that what was recorded is there however the recording ends. Raises OSError."""

    def __init__(self, path: Path, header: Header) -> None:
        self.counts: dict[str, int] = {"out": 0, "in": 0}
        """Bytes in each direction."""
        self._file: TextIO = path.open("w", encoding="ascii", buffering=1)
        self._write({"capture": VERSION, **{name: getattr(header, name) for name in Header.__slots__}})

    def __enter__(self) -> CaptureFile:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._file.close()

    def put(self, record: Record) -> None:
        """Append one."""
        line: dict[str, Any] = {"t": round(record.time_s, 4), "link": record.link}
        if record.event:
            self._write(line | {"event": record.event})
            return
        self.counts[record.direction] += len(record.data)
        line["dir"] = record.direction
        if record.can_id is not None:
            line["id"] = f"{record.can_id:03x}"
        elif not record.data.translate(None, READABLE):
            self._write(line | {"text": record.data.decode("ascii")})
            return
        self._write(line | {"hex": record.data.hex()})

    def _write(self, line: Mapping[str, Any]) -> None:
        self._file.write(json.dumps(line) + "\n")


def read_capture(path: Path) -> tuple[Header, tuple[Record, ...]]:
    """A recorded bus. Raises ConfigError with the line that is wrong."""
    try:
        lines = [json.loads(line) for line in path.read_text(encoding="ascii").splitlines()]
        first = lines[0]
        if first.pop("capture") != VERSION:
            raise ConfigError(f"no capture of version {VERSION}", place=f"{path.name}:1")
        header = Header(**first | {"devices": tuple(first["devices"])})
    except (OSError, ValueError, LookupError, TypeError, AttributeError) as error:
        raise ConfigError(f"no capture: {error!r}", place=path.name) from None
    return header, tuple(_record(path, number, line) for number, line in enumerate(lines[1:], 2))


def _record(path: Path, number: int, line: Any) -> Record:
    try:
        time_s, link = float(line["t"]), int(line["link"])
        if event := line.get("event"):
            return Record(time_s, link=link, event=str(event), line=number)
        if line["dir"] not in get_args(Direction):
            raise ValueError(f"direction {line['dir']!r}")
        data = line["text"].encode("ascii") if "text" in line else bytes.fromhex(line["hex"])
        can_id = int(line["id"], 16) if "id" in line else None
        return Record(time_s, line["dir"], data, can_id, link, line=number)
    except (ValueError, LookupError, TypeError, AttributeError) as error:
        raise ConfigError(f"no record: {error!r}", place=f"{path.name}:{number}") from None
