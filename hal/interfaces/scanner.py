"""The structured-light camera."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol

import numpy as np
from numpy.typing import NDArray

from hal.interfaces.base import Device

View = Literal["rotor", "shaft", "artefact_rotor", "artefact_shaft"]
"""What the camera looks at. The two ``artefact_*`` views use the camera poses of ``rotor`` (looking up) and
``shaft`` (looking down) on the two-sided sphere artefact that is fixed to the bench."""


@dataclass(frozen=True, slots=True)
class Frame:
    """One organised cloud in the scanner's own frame.

    `points_mm` is (H, W, 3) float32, NaN where nothing was measured; z points away from the camera.
    `frame_id` grows with each capture; a repeated one is an old frame.
    """

    frame_id: int
    view: View
    time_s: float
    points_mm: NDArray[np.float32]


class Scanner(Device, Protocol):
    """A structured-light binocular camera."""

    async def capture(self, view: View) -> Frame: ...
