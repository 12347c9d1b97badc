"""Rigid transforms of the plant, and random children named by words. `T_target_source` carries source to target."""

from __future__ import annotations

import zlib

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def rotation_x(angle_rad: float) -> Array:
    """(3, 3) right-handed about x."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_y(angle_rad: float) -> Array:
    """(3, 3) right-handed about y."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]])


def rotation_z(angle_rad: float | Array) -> Array:
    """(..., 3, 3) right-handed about z."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    rotation = np.zeros((*angle.shape, 3, 3))
    rotation[..., 0, 0] = rotation[..., 1, 1] = np.cos(angle)
    rotation[..., 1, 0] = np.sin(angle)
    rotation[..., 0, 1] = -rotation[..., 1, 0]
    rotation[..., 2, 2] = 1.0
    return rotation


def pose(rotation: Array, translation_mm: Array) -> Array:
    """(4, 4) from (3, 3) and (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = rotation
    matrix[:3, 3] = translation_mm
    return matrix


def small_pose(shift_mm: Array, rotation_deg: Array) -> Array:
    """(4, 4) of a shift (3,) and rotations about x, y, z (3,) in degrees, applied x first."""
    rx, ry, rz = np.radians(rotation_deg)
    return pose(rotation_z(float(rz)) @ rotation_y(float(ry)) @ rotation_x(float(rx)), shift_mm)


def child_rng(seed: int, *names: str) -> np.random.Generator:
    """Generator of its own for one named quantity: drawing more or less of one leaves the others as they are."""
    key = tuple(zlib.crc32(name.encode()) for name in names)
    return np.random.Generator(np.random.PCG64(np.random.SeedSequence(entropy=seed, spawn_key=key)))
