"""The scene of one plant: its present poses and true parts as the camera's input. Pure; reads the plant only."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from hal.fake.geometry import JointGeometry
from hal.fake.plant import Plant
from hal.fake.scene.artefacts import BenchFurniture
from hal.fake.scene.camera import ScanErrors, camera_for
from hal.fake.scene.render import SceneState
from hal.fake.scene.shapes import Holes, PartShape, Studs
from hal.fake.scene.thread_form import StudForm
from hal.interfaces import View

Array = NDArray[np.float64]
LEDGE_WIDTH_MM = 10.0
"""The ledge is a rim outside the face, stepped back."""
BORE_DEPTH_MM = 60.0


def picture_of(plant: Plant, view: View, points: int) -> SceneState:
    """What the camera stands before in `view`, with about `points` pixels. The plant has been advanced to now."""
    both = ((plant.T_cell_shaft(), shaft_shape(plant)), (plant.T_cell_rotor(), rotor_shape(plant)))
    parts = () if plant.bare else both
    return SceneState(
        T_cell_camera=plant.T_cell_camera("rotor" if view in ("rotor", "artefact_rotor") else "shaft"),
        parts=parts,
        clutter=BenchFurniture().clutter(),
        camera=camera_for(points),
        errors=scan_errors(plant),
    )


def scan_errors(plant: Plant) -> ScanErrors:
    """The plant's own instrument: strengths by level, scale and fringe phase as built."""
    table = plant.numbers.imperfections
    phase = plant.rng("scanner", "ripple").uniform(0.0, 360.0)
    perfect = table.scanner_outliers == 0.0
    return ScanErrors(
        noise_mm=table.scanner_noise_mm,
        correlation_px=table.scanner_correlation_px,
        ripple_mm=table.scanner_ripple_mm,
        ripple_phase_deg=float(phase),
        scale=plant.cell.scanner_scale,
        outliers=table.scanner_outliers,
        flying=0.0 if perfect else ScanErrors().flying,
        bands=0 if perfect else ScanErrors().bands,
    )


def shaft_shape(plant: Plant) -> PartShape:
    """Shaft: face with holes, ledge, spigot bore with its lead-in."""
    drawing, truth = plant.geometry, plant.shaft
    rim, bore, lead = 0.5 * drawing.face_outer_diameter_mm, 0.5 * drawing.spigot_diameter_mm, drawing.spigot_chamfer_mm
    inner = max(0.5 * drawing.face_inner_diameter_mm, bore + lead)
    mouth = 0.5 * (drawing.hole_chamfer_diameter_mm + truth.diameter_mm - drawing.hole_diameter_mm)
    holes = Holes(
        center_mm=truth.hole_mm,
        axis=_axes(truth.slope),
        radius_mm=0.5 * truth.diameter_mm,
        mouth_radius_mm=mouth,
        chamfer_tan=float(np.tan(np.radians(drawing.hole_chamfer_half_angle_deg))),
        depth_mm=drawing.hole_depth_mm,
    )
    return PartShape(
        rings_mm=((inner, rim, 0.0), *_ledge(drawing)),
        bevels_mm=((bore, -lead, bore + lead, 0.0),) if lead > 0.0 else (),
        bore_mm=(bore, -lead, -BORE_DEPTH_MM),
        holes=holes,
    )


def rotor_shape(plant: Plant) -> PartShape:
    """Rotor: face with studs, ledge, male spigot with its lead-in, bore."""
    drawing, truth = plant.geometry, plant.rotor
    rim, spigot = 0.5 * drawing.face_outer_diameter_mm, 0.5 * drawing.spigot_diameter_mm
    lead, height, bore = drawing.spigot_chamfer_mm, drawing.spigot_length_mm, 0.5 * drawing.bore_diameter_mm
    form = StudForm(
        crest_radius_mm=0.5 * float(np.mean(truth.diameter_mm)),
        pitch_mm=drawing.thread_pitch_mm,
        starts=drawing.thread_starts,
        hand=1 if drawing.thread_hand == "right" else -1,
        length_mm=drawing.stud_length_mm,
        lead_in_tan=float(np.tan(np.radians(drawing.stud_lead_in_half_angle_deg))),
    )
    phase = plant.rng("rotor", truth.serial, "thread phase").random(drawing.count)
    return PartShape(
        rings_mm=(
            (bore, spigot - lead, height),
            (max(spigot, 0.5 * drawing.face_inner_diameter_mm), rim, 0.0),
            *_ledge(drawing),
        ),
        bevels_mm=((spigot - lead, height, spigot, height - lead),) if lead > 0.0 else (),
        bore_mm=(bore, height, -BORE_DEPTH_MM),
        studs=Studs(center_mm=truth.stud_mm, axis=_axes(truth.slope), phase=phase, form=form),
    )


def _ledge(drawing: JointGeometry) -> tuple[tuple[float, float, float], ...]:
    rim = 0.5 * drawing.face_outer_diameter_mm
    return ((rim, rim + LEDGE_WIDTH_MM, -drawing.ledge_step_mm),) if drawing.ledge_step_mm > 0.0 else ()


def _axes(slope: Array) -> Array:
    """(n, 3) unit axes of features whose axis at height z is at position + z * slope."""
    axis = np.column_stack([slope, np.ones(len(slope))])
    return np.asarray(axis / np.linalg.norm(axis, axis=1, keepdims=True))
