"""The face as a raster, so that neighbours are cells: where it is covered, and where it has round voids."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import fft, ndimage

from cellctl.vision.geometry import Array

Bits = NDArray[np.bool_]
MAX_CELLS = 4096
MAX_VOIDS = 600
"""Five times the features of the largest pattern: the pattern is voted for by all pairs."""


@dataclass(frozen=True, slots=True)
class Raster:
    """Cells of `cell_mm` on a plane; `counts` (U, V) points in each, cell (0, 0) starts at `low` (2,) mm."""

    counts: NDArray[np.int32]
    low: Array
    cell_mm: float

    def covered(self, gap: int = 2) -> Bits:
        """(U, V) which cells hold a point; gaps between covered ones that hold no square of `gap` cells count too."""
        # closing by a square, a side at a time: wider by the cells of a gap, and narrower again
        there = self.counts > 0
        for axis in (0, 1):
            there = _any_of(there, gap, axis)
        empty = ~there
        for axis in (0, 1):
            empty = _any_of(empty, gap, axis)
        return np.asarray(~empty[gap - 1 : 1 - gap or None, gap - 1 : 1 - gap or None])

    def position(self, cells: Array) -> Array:
        """Plane coordinates (n, 2) of cell centres (n, 2)."""
        return np.asarray(self.low + (cells + 0.5) * self.cell_mm)


def _any_of(bits: Bits, count: int, axis: int) -> Bits:
    """Whether any of `count` cells in a row is set, for every such row along one axis that meets the raster."""
    bits = np.moveaxis(bits, axis, 0)
    result = np.zeros((len(bits) + count - 1, bits.shape[1]), dtype=np.bool_)
    for shift in range(count):
        result[shift : shift + len(bits)] |= bits
    return np.moveaxis(result, 0, axis)


@dataclass(frozen=True, slots=True)
class Void:
    """A round hole in the face's raster: plane position (2,), radius, and how well it shows (0 to 1)."""

    position_mm: Array
    radius_mm: float
    score: float


def spacing(uv: Array, *, coarse_mm: float) -> float:
    """Mean point spacing in mm on a surface of plane coordinates (N, 2), from the density of the covered part."""
    rows, columns = ((side - side.min()) * (1.0 / coarse_mm) for side in np.ascontiguousarray(uv.T))
    cells = rows.astype(np.int64) * (int(columns.max()) + 1) + columns.astype(np.int64)
    counts = np.bincount(cells)
    # cells weighted by their points: the rim's cells and strays count little
    mean = float((counts.astype(np.float64) ** 2).sum() / counts.sum())
    return coarse_mm / float(np.sqrt(max(mean, 1e-9)))


def rasterise(uv: Array, cell_mm: float, margin_mm: float = 0.0) -> Raster:
    """Raster of plane coordinates (N, 2), with an empty margin all around. Strays far out are left away."""
    low, high = np.percentile(uv[:: max(1, len(uv) // 20_000)], [0.1, 99.9], axis=0)
    low, high = low - 0.05 * (high - low) - margin_mm, high + 0.05 * (high - low) + margin_mm
    cell_mm = max(cell_mm, float((high - low).max()) / MAX_CELLS)
    rows, columns = (int(np.ceil(side)) + 1 for side in (high - low) / cell_mm)
    u, v = ((side - least) * (1.0 / cell_mm) for side, least in zip(np.ascontiguousarray(uv.T), low, strict=True))
    inside = (u >= 0.0) & (u < rows) & (v >= 0.0) & (v < columns)
    flat = u[inside].astype(np.int64) * columns + v[inside].astype(np.int64)
    counts = np.bincount(flat, minlength=rows * columns).reshape(rows, columns)
    return Raster(counts.astype(np.int32), low, cell_mm)


def find_voids(raster: Raster, radii_mm: tuple[float, ...], *, gap: int = 2, score: float = 0.45) -> list[Void]:
    """Round voids of about one of the radii: an empty disk inside a covered ring, best score first. `gap` as in
    `Raster.covered`.

    A matched filter, so that a hole whose rim is torn open by missing data is still seen; slots and bores, whose
    ring is not covered all around, are not.
    """
    covered = raster.covered(gap).astype(np.float32)
    pad = int(np.ceil(2.0 * max(radii_mm) / raster.cell_mm)) + 2
    shape = [fft.next_fast_len(side + pad, real=True) for side in covered.shape]
    spectrum = fft.rfft2(covered, shape)
    voids: list[Void] = []
    for radius in radii_mm:
        quality = _quality(spectrum, shape, radius / raster.cell_mm)[: covered.shape[0], : covered.shape[1]]
        peaks = _peaks(quality, score, 0.8 * radius / raster.cell_mm)
        voids += [_void(raster, covered, cell, radius, float(quality[tuple(cell)])) for cell in peaks]
    return _best_of_overlapping(voids)


def _peaks(quality: Array, least: float, reach: float) -> list[NDArray[np.int64]]:
    """Cells (2,) above `least` that are the best within `reach` cells, best first."""
    cells = np.argwhere(quality > least)
    cells = cells[np.argsort(-quality[cells[:, 0], cells[:, 1]], kind="stable")]
    found = []
    while len(cells):
        found.append(cells[0])
        cells = cells[(np.abs(cells - cells[0]) > reach).any(axis=1)]
    return found


def _void(
    raster: Raster, covered: NDArray[np.float32], cell: NDArray[np.int64], radius_mm: float, score: float
) -> Void:
    """Void with centre and radius from the area that is not covered."""
    reach = int(np.ceil(1.3 * radius_mm / raster.cell_mm)) + 1
    u0, v0 = np.maximum(cell - reach, 0)
    empty = covered[u0 : cell[0] + reach + 1, v0 : cell[1] + reach + 1] < 0.5
    u, v = np.nonzero(empty)
    near = np.hypot(u + u0 - cell[0], v + v0 - cell[1]) * raster.cell_mm <= 1.25 * radius_mm
    if not near.any():
        return Void(raster.position(cell.astype(np.float64)), radius_mm, score)
    centre = np.array([u[near].mean() + u0, v[near].mean() + v0])
    area = float(np.count_nonzero(near)) * raster.cell_mm**2
    return Void(raster.position(centre), float(np.sqrt(area / np.pi)), score)


def _quality(spectrum: NDArray[np.complex64], shape: list[int], radius: float) -> Array:
    """Emptiness of the disk times coverage of the ring around it, for every cell as centre; radius in cells."""
    half = int(np.ceil(1.7 * radius + 2.0))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    rho = np.hypot(x, y)
    disk = rho <= max(0.82 * radius, 0.5)
    ring = (rho >= 1.0 * radius + 1.0) & (rho <= 1.0 * radius + 1.0 + max(2.0, 0.3 * radius))
    kernels = []
    for mask in (disk, ring):
        kernel = np.zeros(shape, dtype=np.float32)
        kernel[: 2 * half + 1, : 2 * half + 1] = mask / mask.sum()
        kernel = np.roll(kernel, (-half, -half), axis=(0, 1))
        kernels.append(fft.irfft2(spectrum * np.conj(fft.rfft2(kernel)), shape))
    quality = np.clip(1.0 - kernels[0], 0.0, 1.0) ** 2 * np.clip(kernels[1], 0.0, 1.0)
    # equal scores inside one void would all be peaks: a hair of smoothing leaves one
    return np.asarray(ndimage.gaussian_filter(quality, 0.25 * radius, mode="nearest", truncate=2.0))


def _best_of_overlapping(voids: list[Void]) -> list[Void]:
    """Voids that do not overlap a better one; the best `MAX_VOIDS`, because a sieve has thousands."""
    ordered = sorted(voids, key=lambda item: (-item.score, *item.position_mm))
    positions = np.array([void.position_mm for void in ordered]).reshape(-1, 2)
    free = np.ones(len(ordered), dtype=np.bool_)
    kept: list[Void] = []
    for i, void in enumerate(ordered):
        if free[i] and len(kept) < MAX_VOIDS:
            kept.append(void)
            free &= np.hypot(*(positions - void.position_mm).T) > void.radius_mm
    return kept


def find_islands(raster: Raster, *, least: int = 3) -> list[Void]:
    """Connected groups of covered cells (tips of studs, seen above the face), largest first; score is 1."""
    joined = ndimage.binary_dilation(raster.counts > 0, iterations=1)
    labels, count = ndimage.label(joined)
    if count == 0:
        return []
    weights = raster.counts.astype(np.float64)
    index = np.arange(1, count + 1)
    points = ndimage.sum_labels(weights, labels, index)
    centres = np.array(ndimage.center_of_mass(weights, labels, index))
    order = np.argsort(-points, kind="stable")
    cells = ndimage.sum_labels(raster.counts > 0, labels, index)
    radii = np.sqrt(cells / np.pi) * raster.cell_mm
    return [Void(raster.position(centres[i]), float(radii[i]), 1.0) for i in order[:MAX_VOIDS] if points[i] >= least]
