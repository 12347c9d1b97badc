"""What every scanner on a wire must do about a frame that goes wrong."""

from __future__ import annotations

import pytest

from hal.errors import DeviceError
from hal.interfaces import Scanner


async def each_goes_wrong_once(
    scanner: Scanner, wire: object, kind: str, value: object, error: type[DeviceError], reason: str, *, times: int
) -> None:
    """With `kind` of the simulator's `wire` at `value` a capture fails as it should; the next one is good and new."""
    frame_id, plain = 0, getattr(wire, kind)
    for _ in range(times):
        setattr(wire, kind, value)
        with pytest.raises(error, match=f"scanner: .*{reason}"):
            await scanner.capture("rotor")
        setattr(wire, kind, plain)
        frame = await scanner.capture("rotor")
        assert frame.frame_id > frame_id + 1, "the frame that went wrong had a number too"
        frame_id = frame.frame_id
