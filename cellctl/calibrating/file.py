"""The calibration file as text, and put in its place whole: a reader finds the old one or the new one, never a part."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from cellctl.calibration import Calibration
from cellctl.whole_file import whole_file


def save_calibration(path: Path, calibration: Calibration) -> None:
    """Write it in the place of the one before, durably. Raises OSError."""
    with whole_file(path, mode=0o644) as file:
        file.write(as_toml(calibration).encode())


def as_toml(calibration: Calibration) -> str:
    """TOML that `cellctl.calibration.load_calibration` reads back to the same values."""
    data = calibration.model_dump(exclude_none=True)
    return "# Written by `cellctl calibrate`. Cell frame, millimetres, degrees, newton; one sigma everywhere.\n" + (
        "\n".join(_table((), data)) + "\n"
    )


def _table(place: tuple[str, ...], data: Mapping[str, Any]) -> list[str]:
    """Plain values first, then the tables inside."""
    inner = {key: value for key, value in data.items() if isinstance(value, Mapping)}
    plain = {key: value for key, value in data.items() if key not in inner}
    lines = ["", f"[{'.'.join(map(_key, place))}]"] if place and (plain or not inner) else []
    lines += [f"{_key(key)} = {_value(value)}" for key, value in plain.items()]
    for key, value in inner.items():
        lines += _table((*place, key), value)
    return lines


def _key(name: str) -> str:
    bare = name.isascii() and name.replace("_", "").replace("-", "").isalnum()
    return name if bare else _value(name)


def _value(value: Any) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"
    if isinstance(value, int):
        return str(value)
    if isinstance(value, float):
        return repr(float(value))
    if isinstance(value, datetime):
        return value.astimezone(UTC).isoformat(timespec="seconds").replace("+00:00", "Z")
    if isinstance(value, str):
        escaped = "".join(c if c.isprintable() and c not in '"\\' else f"\\U{ord(c):08X}" for c in value)
        return f'"{escaped}"'
    if isinstance(value, Sequence):
        nested = any(isinstance(one, Sequence) and not isinstance(one, str) for one in value)
        return "[" + (",\n    " if nested else ", ").join(map(_value, value)) + "]"
    raise TypeError(f"no TOML for {type(value).__name__}")
