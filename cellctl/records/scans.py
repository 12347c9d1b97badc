"""The scans that a run's journal names, and what was measured in each. Pure functions of the rows."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from cellctl.records.blobs import scans_of
from cellctl.records.canonical import number_of
from cellctl.records.chain import Row
from cellctl.vision.part import FaceFit, FeatureFit, PartMeasurement, ThreadFit

Array = NDArray[np.float64]
Plain = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Measured:
    """What was measured in a scan, in the cell frame, and the pose (4, 4) of the scanner that it was measured with."""

    part: PartMeasurement
    T_cell_scanner: Array


@dataclass(frozen=True, slots=True)
class RunScan:
    """One cloud of a run. `blob` is its content hash, kept or not; `measured` is the journal's value, None where
    nothing was measured in it, `refused` then the reason why, if one was given."""

    view: str
    frame_id: int
    utc: str
    blob: str
    measured: Plain | None = None
    refused: str = ""

    @property
    def placed(self) -> bool:
        """Whether something was measured in it and the record says where the scanner stood."""
        return self.measured is not None and "T_cell_scanner" in self.measured

    def measurement(self) -> Measured | None:
        """The measurement, None unless `placed`. Raises KeyError, ValueError for a value that is none."""
        if self.measured is None or not self.placed:
            return None
        return Measured(measurement_of(self.measured["measurement"]), _array(self.measured["T_cell_scanner"]))


def run_scans(rows: tuple[Row, ...]) -> tuple[RunScan, ...]:
    """Every cloud that the scanner gave, in the order in which they were taken."""
    scans: list[RunScan] = []
    latest: dict[str, int] = {}
    for row in rows:
        for _, digest in scans_of(row) if row.kind == "result" else ():
            frame = row.value["result"]
            latest[frame["view"]] = len(scans)
            scans.append(RunScan(frame["view"], int(frame["frame_id"]), row.utc, digest))
        if row.kind in ("measurement", "scan_refused"):
            value = row.value
            index = latest.get(value.get("side"))
            if index is not None:
                scans[index] = _judged(scans[index], row.kind, value)
    return tuple(scans)


def _judged(scan: RunScan, kind: str, value: Plain) -> RunScan:
    """The scan with what was said about it: a row speaks of the newest scan of its side."""
    if kind == "scan_refused":
        return RunScan(scan.view, scan.frame_id, scan.utc, scan.blob, None, str(value.get("reason", "")))
    return RunScan(scan.view, scan.frame_id, scan.utc, scan.blob, value)


def measurement_of(plain: Plain) -> PartMeasurement:
    """A measurement as the journal holds it. Raises KeyError, ValueError where it is none."""
    return PartMeasurement(
        frame=plain["frame"],
        feature=plain["feature"],
        face=_face(plain["face"]),
        T_frame_part=_array(plain["T_frame_part"]),
        covariance=_array(plain["covariance"]),
        sigma_clocking_deg=number_of(plain["sigma_clocking_deg"]),
        clocking_free=plain["clocking_free"],
        features=tuple(_feature(feature) for feature in plain["features"]),
        circle_diameter_mm=number_of(plain["circle_diameter_mm"]),
        quality={name: number_of(value) for name, value in plain["quality"].items()},
        ledge_step_mm=_number(plain.get("ledge_step_mm")),
    )


def _face(plain: Plain) -> FaceFit:
    return FaceFit(
        point_mm=_array(plain["point_mm"]),
        normal=_array(plain["normal"]),
        tilt_axes=_array(plain["tilt_axes"]),
        covariance=_array(plain["covariance"]),
        sigma_mm=number_of(plain["sigma_mm"]),
        flatness_mm=number_of(plain["flatness_mm"]),
        points=int(plain["points"]),
        inliers=number_of(plain["inliers"]),
    )


def _feature(plain: Plain) -> FeatureFit:
    center_mm, axis, covariance_mm2 = (None if plain[name] is None else _array(plain[name]) for name in ARRAYS)
    thread = plain["thread"]
    return FeatureFit(
        index=int(plain["index"]),
        found=plain["found"],
        radius_mm=_number(plain["radius_mm"]),
        axis_sigma_deg=_number(plain["axis_sigma_deg"]),
        thread=_thread(thread) if thread is not None else None,
        points=int(plain["points"]),
        residual_mm=number_of(plain["residual_mm"]),
        reason=plain["reason"],
        chamfer_radius_mm=_number(plain.get("chamfer_radius_mm")),
        pivot_mm=number_of(plain.get("pivot_mm", 0.0)),
        center_mm=center_mm,
        axis=axis,
        covariance_mm2=covariance_mm2,
    )


ARRAYS = ("center_mm", "axis", "covariance_mm2")


def _thread(plain: Plain) -> ThreadFit:
    numbers = {name: number_of(value) for name, value in plain.items() if name not in ("hand", "starts")}
    return ThreadFit(hand=plain["hand"], starts=int(plain["starts"]), **numbers)


def _number(value: object) -> float | None:
    return None if value is None else number_of(value)


def _array(value: object) -> Array:
    return np.asarray(value, dtype=np.float64)
