"""The vision core as the steps see it: frames in, measurements out, the work done by `hal.jobs` wherever that is."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from cellctl.calibration import Calibration
from cellctl.docking import Alignment, AlignSpec, align
from cellctl.kinematics import AxesPosition
from cellctl.vision.measure import DEFAULT_GATES, Gates, measure_part
from cellctl.vision.part import Part, PartMeasurement
from cellctl.vision.spheres import artefact_residuals
from hal.interfaces import Frame, View
from hal.jobs import Jobs

Array = NDArray[np.float64]
MEASURE_S = 0.8
ARTEFACT_S = 0.3
"""Cell time that a measurement is charged under virtual time: a 0.5 M point cloud on one core."""
ALIGN_S = 0.2
"""Cell time that an alignment is charged: 36 bolts on one core."""
WARM = ("cellctl.docking", "cellctl.vision.measure", "cellctl.vision.spheres")
"""Modules that a worker process imports beforehand."""


class VisionWorker:
    """`cellctl.ports.Vision`. Poses of the camera come from the calibration, never from anywhere else."""

    def __init__(
        self,
        jobs: Jobs,
        calibration: Calibration,
        *,
        gates: Gates = DEFAULT_GATES,
        seed: int = 0,
        measure_s: float = MEASURE_S,
        artefact_s: float = ARTEFACT_S,
        align_s: float = ALIGN_S,
    ) -> None:
        self._jobs = jobs
        self._calibration = calibration
        self._measure = partial(measure_part, gates=gates, seed=seed)
        self._measure_s = measure_s
        self._artefact_s = artefact_s
        self._align_s = align_s

    async def measure(self, frame: Frame, part: Part) -> PartMeasurement:
        """One part in the cell frame. Raises Refused, or WorkerError when the worker died or was late."""
        pose = self._pose(frame.view)
        return await self._jobs.run(self._measure, frame.points_mm, part, pose, latency_s=self._measure_s)

    async def artefact(self, frame: Frame) -> Array:
        """Residuals (n, 3) in mm of the artefact's sphere centres, measured minus certified, cell frame.

        Raises Refused where a sphere is not found near its place, and WorkerError as `measure`.
        """
        artefact = self._calibration.artefact
        side = artefact.rotor_side_mm if frame.view in ("rotor", "artefact_rotor") else artefact.shaft_side_mm
        return await self._jobs.run(
            artefact_residuals,
            frame.points_mm,
            self._pose(frame.view),
            np.array(side, dtype=np.float64),
            artefact.sphere_diameter_mm,
            latency_s=self._artefact_s,
        )

    async def align(
        self, rotor: PartMeasurement, shaft: PartMeasurement, measured_at: AxesPosition, spec: AlignSpec
    ) -> Alignment:
        """Where the shaft has to go, see `cellctl.docking.align`. Raises Refused, and WorkerError as `measure`."""
        return await self._jobs.run(align, rotor, shaft, self._calibration, measured_at, spec, latency_s=self._align_s)

    def _pose(self, view: View) -> Array:
        return self._calibration.views["rotor" if view in ("rotor", "artefact_rotor") else "shaft"].matrix
