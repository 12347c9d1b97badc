"""Where the devices of a cell file are reached, and which of them share a wire."""

from __future__ import annotations

import os
from collections.abc import Mapping

from hal.config import CellConfig


def bus_of(config: CellConfig, name: str) -> str:
    """The wire that device `name` is on, in words that are the same for all on it; empty for a fake, on no wire."""
    entry = config.entries[name]
    if entry.kind == "canopen" and config.can is not None:
        return f"CAN {config.can.channel}"
    if path := getattr(entry, "port_path", "") or getattr(entry, "path", "") or getattr(entry, "folder", ""):
        return os.path.normpath(config.beside(path))
    if host := getattr(entry, "host", ""):
        return f"{entry.kind} {host}:{entry.port}"
    return ""


def address_of(config: CellConfig, name: str) -> str:
    """As `bus_of`, with the number that the device has there."""
    entry = config.entries[name]
    numbers = [f"{word} {getattr(entry, word)}" for word in ("node", "unit") if hasattr(entry, word)]
    return " ".join((bus_of(config, name).removeprefix(f"{entry.kind} "), *numbers))


def buses(config: CellConfig) -> Mapping[str, list[str]]:
    """Names of the devices on each wire, in the order of the cell file."""
    found: dict[str, list[str]] = {}
    for name in config.entries:
        if bus := bus_of(config, name):
            found.setdefault(bus, []).append(name)
    return found
