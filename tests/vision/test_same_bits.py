"""The same cloud gives the same bits, whatever the number of threads of the numeric libraries."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

PROGRAM = """
import hashlib
import numpy as np
from cellctl.vision.measure import measure_part
from tests.vision.joints import {kind}
from tests.vision.synthetic import render

rng = np.random.default_rng(5)
view = {kind}(rng, 250_000)
cloud = render(view, rng)
for points in (cloud, cloud[np.isfinite(cloud[..., 0])]):
    measured = measure_part(points, view.part)
    print(hashlib.sha256(measured.T_frame_part.tobytes() + measured.covariance.tobytes() + b"".join(
        f.center_mm.tobytes() + f.covariance_mm2.tobytes() for f in measured.features if f.found)).hexdigest())
"""


@pytest.mark.parametrize("kind", ["random_view", "stressed_view"])
def test_threads_change_no_bit(kind: str) -> None:
    answers = set()
    for threads in ("1", "2"):
        named = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
        environment = os.environ | dict.fromkeys(named, threads)
        ran = subprocess.run([sys.executable, "-c", PROGRAM.format(kind=kind)], env=environment, capture_output=True,
                             text=True, check=True)  # fmt: skip
        assert len(ran.stdout.split()) == 2
        answers.add(ran.stdout)
    assert len(answers) == 1
