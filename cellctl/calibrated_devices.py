"""With which devices a calibration was made, and whether they are those that are there. Pure."""

from __future__ import annotations

from collections.abc import Mapping

from cellctl.calibration import Calibration, Procedure
from hal.interfaces import Identity


def told(identity: Identity) -> str:
    """A device in one line, as the calibration file records it."""
    return f"{identity.vendor} {identity.model}, serial {identity.serial}, firmware {identity.firmware}"


def other_devices(
    calibration: Calibration, present: Mapping[str, Identity], *, but: Procedure | None = None
) -> tuple[str, ...]:
    """A sentence for each device that is not the one with which a part of `calibration` was made, `but` that part.

    Firmware may change. A part that was not measured on the cell records no devices and fits any; a device that is not
    `present` is none of this question's.
    """
    return tuple(
        f"{device}: part {part} of calibration {calibration.id} was made with {_unit(recorded)}; "
        f"here is {_unit(told(present[device]))}"
        for part, made in calibration.made.items()
        for device, recorded in made.devices.items()
        if part != but and device in present and _unit(told(present[device])) != _unit(recorded)
    )


def _unit(line: str) -> str:
    return line.rpartition(", firmware")[0] or line
