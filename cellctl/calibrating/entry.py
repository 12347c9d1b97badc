"""A part of the calibration file and how it takes its place there. Pure."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from cellctl.calibrated_devices import other_devices
from cellctl.calibration import Calibration, Made, Procedure
from cellctl.vision.part import Refused
from hal.interfaces import Identity


@dataclass(frozen=True, slots=True)
class Part:
    """One part of the file: sections that take the place of what was there, and how they were made."""

    procedure: Procedure
    sections: Mapping[str, Any]
    stops: int
    figures: Mapping[str, float]


def require_same_devices(base: Calibration, procedure: Procedure, devices: Mapping[str, Identity]) -> None:
    """What `base` holds from other procedures must be of these very devices. Raises Refused other_devices."""
    if others := other_devices(base, devices, but=procedure):
        raise Refused("other_devices", "; ".join(others))


def put_in(
    base: Calibration, part: Part, *, name: str, started: datetime, until: datetime | None, devices: Mapping[str, str]
) -> Calibration:
    """The file with this part in place; valid from `started` on, as long as `base` unless `until` says otherwise.

    Raises Refused calibration_expired where that is over already.
    """
    valid_until = base.valid_until if until is None else until
    if valid_until <= started:
        raise Refused("calibration_expired", f"it would be valid until {valid_until:%Y-%m-%d} only: say for how long")
    made = Made(at=started, devices=dict(devices), stops=part.stops, figures=dict(part.figures))
    changed = {
        **part.sections,
        "id": f"{name}-{started:%Y%m%dT%H%M%S}-{part.procedure}",
        "valid_from": started,
        "valid_until": valid_until,
        "made": {**base.made, part.procedure: made},
    }
    return Calibration.model_validate(base.model_copy(update=changed).model_dump())
