"""`cellctl measure`: vision alone, on clouds from files. Exit 0 measured, 3 refused with a reason, 2 unreadable."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np

from cellctl.calibration import Calibration, load_calibration
from cellctl.cli.measure_alignment import alignment_document
from cellctl.recipe import Recipe, load_recipe
from cellctl.scan_gates import gates_of
from cellctl.view.page import Look, page
from cellctl.vision.cloud import Unreadable, load_cloud
from cellctl.vision.geometry import Array
from cellctl.vision.measure import measure_part
from cellctl.vision.part import FeatureFit, PartMeasurement, Refused
from hal.errors import ConfigError

Side = Literal["rotor", "shaft"]
SIDES: tuple[Side, ...] = ("rotor", "shaft")


def add_parser(subparsers: Any) -> None:
    """Add `measure` to the commands."""
    parser = subparsers.add_parser("measure", help="measure clouds of rotor and shaft (PLY, PCD, XYZ, NPY, NPZ; mm)")
    parser.add_argument("--recipe", type=Path, required=True, help="recipe with [recipe], [pattern] and the part")
    parser.add_argument("--rotor", type=Path, help="cloud of the rotor")
    parser.add_argument("--shaft", type=Path, help="cloud of the shaft")
    parser.add_argument("--calibration", type=Path, help="scanner poses; without it both clouds are in one frame")
    parser.add_argument("--view", type=Path, help="also write a page (HTML) that shows clouds, fits and residuals")
    parser.add_argument("--seed", type=int, default=0, help="seed of the plane search (default 0)")
    parser.add_argument("--json", action="store_true", help="one JSON document on standard output")
    parser.set_defaults(run=run)


def run(args: argparse.Namespace) -> int:
    """Measure and print. Returns the exit code."""
    try:
        recipe = load_recipe(args.recipe)
        calibration = load_calibration(args.calibration) if args.calibration else None
        looks = _measure(args, recipe, calibration)
        measured = {side: look.measured for side, look in looks.items()}
        document = as_document(measured)
        if len(measured) == 2:
            document["alignment"] = alignment_document(measured["rotor"], measured["shaft"], recipe, calibration)
        if args.view is not None:
            args.view.write_text(_page(looks, recipe, document), encoding="utf-8")
        answer = json.dumps(document, allow_nan=False) if args.json else _as_text(measured, document)
    except Refused as refused:
        return _refused(refused, args.json)
    except (Unreadable, ConfigError, OSError) as error:
        print(f"cellctl measure: {error}", file=sys.stderr)
        if args.json:
            print(json.dumps({"error": {"code": "unreadable", "reason": str(error)}}))
        return 2
    except (ArithmeticError, LookupError, MemoryError, ValueError) as error:
        # a cloud whose numbers defeat the arithmetic is refused like any other that cannot be measured
        return _refused(Refused("not_measurable", f"the fit breaks down: {type(error).__name__}: {error}"), args.json)
    print(answer)
    return 0


def _refused(refused: Refused, as_json: bool) -> int:
    document = {"refused": {"code": refused.code, "reason": refused.reason}}
    print(json.dumps(document) if as_json else f"refused ({refused.code}): {refused.reason}")
    return 3


def _measure(args: argparse.Namespace, recipe: Recipe, calibration: Calibration | None) -> dict[Side, Look]:
    clouds: dict[Side, Path | None] = {"rotor": args.rotor, "shaft": args.shaft}
    if not any(clouds.values()):
        raise ConfigError("no cloud is given", place="--rotor or --shaft")
    result: dict[Side, Look] = {}
    for side in SIDES:
        path = clouds[side]
        if path is not None:
            part = recipe.part(side)
            points = load_cloud(path).points
            pose = _pose(calibration, side)
            measured = measure_part(points, part, pose, gates=gates_of(recipe), seed=args.seed)
            result[side] = Look(side, measured, part, points, pose, path.name)
    return result


def _page(looks: dict[Side, Look], recipe: Recipe, document: dict[str, Any]) -> str:
    facts = [("recipe", f"{recipe.recipe.id} version {recipe.recipe.version}"), ("frame", str(document["frame"]))]
    rng = np.random.default_rng(0)
    return page(tuple(looks.values()), rng, facts=facts, alignment=document.get("alignment"))


def _pose(calibration: Calibration | None, side: Side) -> Array | None:
    """Scanner pose of the side's view, None without a calibration. Raises ConfigError where the view is not in it."""
    if calibration is None:
        return None
    if side not in calibration.views:
        raise ConfigError("the calibration has no such view", place=f"views.{side}")
    return calibration.views[side].matrix


def as_document(measured: dict[Side, PartMeasurement]) -> dict[str, Any]:
    """The JSON document of `measure`: plain lists and numbers, null for what is not known."""
    document: dict[str, Any] = {"frame": next(iter(measured.values())).frame}
    for side, part in measured.items():
        document[side] = {
            "face": {
                "point_mm": _plain(part.face.point_mm),
                "normal": _plain(part.face.normal),
                "flatness_mm": part.face.flatness_mm,
                "sigma_mm": part.face.sigma_mm,
            },
            "T_frame_part": _plain(part.T_frame_part),
            "covariance": _plain(part.covariance),
            "sigma_clocking_deg": part.sigma_clocking_deg,
            "clocking_free": part.clocking_free,
            "circle_diameter_mm": part.circle_diameter_mm,
            "features": [_feature(feature) for feature in part.features],
            "quality": {name: _plain(value) for name, value in part.quality.items()},
        }
    return document


def _feature(feature: FeatureFit) -> dict[str, Any]:
    document = {
        "index": feature.index,
        "found": feature.found,
        "center_mm": _plain(feature.center_mm),
        "axis": _plain(feature.axis),
        "radius_mm": _plain(feature.radius_mm),
        "chamfer_radius_mm": _plain(feature.chamfer_radius_mm),
        "covariance_mm2": _plain(feature.covariance_mm2),
        "points": feature.points,
        "residual_mm": _plain(feature.residual_mm),
    }
    if not feature.found:
        document["reason"] = feature.reason
    if feature.thread is not None:
        thread = feature.thread
        document["thread"] = {
            "radius_mm": thread.radius_mm,
            "pitch_mm": thread.pitch_mm,
            "hand": thread.hand,
            "starts": thread.starts,
            "sigma_radius_mm": _plain(thread.sigma_radius_mm),
            "sigma_pitch_mm": _plain(thread.sigma_pitch_mm),
        }
    return document


def _plain(value: Any) -> Any:
    """Numbers and nested lists for JSON; None for what is missing or not finite."""
    if value is None:
        return None
    if isinstance(value, np.ndarray):
        return [_plain(item) for item in value.tolist()]
    if isinstance(value, list):
        return [_plain(item) for item in value]
    number = float(value)
    return number if np.isfinite(number) else None


def _as_text(measured: dict[Side, PartMeasurement], document: dict[str, Any]) -> str:
    """What a person wants to see first."""
    lines = []
    for side, part in measured.items():
        x, y, z = part.T_frame_part[:3, 3]
        lines += [
            f"{side}: {part.found} of {len(part.features)} {part.feature}s found"
            f"{', clocking free' if part.clocking_free else ''}",
            f"  pattern centre  {x:.3f} {y:.3f} {z:.3f} mm ({part.frame} frame)",
            f"  circle diameter {part.circle_diameter_mm:.3f} mm, clocking +- {part.sigma_clocking_deg:.4f} deg",
            f"  face normal     {' '.join(f'{item:.6f}' for item in part.face.normal)}, noise "
            f"{part.face.sigma_mm:.3f} mm, flatness {part.face.flatness_mm:.3f} mm",
        ]
        lines += [f"  {part.feature} {item.index} missing: {item.reason}" for item in part.features if not item.found]
    if "alignment" in document:
        move = document["alignment"]
        lines.append(
            f"alignment: x {move['x_mm']:.3f} mm, y {move['y_mm']:.3f} mm, theta {move['theta_deg']:.4f} deg, "
            f"tilt {move['tilt_deg']:.4f} deg, P(insert) {move['p_insert']:.4f}"
        )
    return "\n".join(lines)
