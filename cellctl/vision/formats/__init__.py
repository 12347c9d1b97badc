"""Bytes of PLY, PCD, XYZ, NPY and NPZ files to points, one module a format.

Headers are strict and lengths are checked both ways: a file that is cut short, or that goes on after its end, is an
error. Each reader gives float32 (N, 3), or (H, W, 3) where the file is organised, and raises ValueError with a reason.
"""

from __future__ import annotations

from cellctl.vision.formats.arrays import read_npy, read_npz
from cellctl.vision.formats.limits import MAX_BYTES, MAX_POINTS
from cellctl.vision.formats.lzf import lzf_decompress
from cellctl.vision.formats.pcd import read_pcd
from cellctl.vision.formats.ply import read_ply
from cellctl.vision.formats.text import read_xyz

__all__ = ["MAX_BYTES", "MAX_POINTS", "lzf_decompress", "read_npy", "read_npz", "read_pcd", "read_ply", "read_xyz"]
