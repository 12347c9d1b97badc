"""The recipe's quality gates of a scan, as the vision core takes them."""

from __future__ import annotations

from cellctl.recipe import Recipe
from cellctl.vision.measure import Gates


def gates_of(recipe: Recipe) -> Gates:
    """The recipe's gates where it gives `[scan]`, else those below which nothing can be measured."""
    if "scan" not in recipe.model_fields_set:
        return Gates()
    scan = recipe.scan
    return Gates(
        distance_low_mm=scan.distance_low_mm,
        distance_high_mm=scan.distance_high_mm,
        min_coverage=scan.min_coverage,
        min_points_per_feature=scan.min_points_per_feature,
        outlier_removal=scan.outlier_removal,
    )
