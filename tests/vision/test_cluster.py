"""Clusters and the crest of a thread: DBSCAN on plain cases, recall and precision on exact threads."""

import numpy as np
import pytest

from cellctl.vision.cluster import crest_points, crest_seed, dbscan

from .thread_scene import Bolt, close_up


def test_two_blobs_and_a_stray_point() -> None:
    generator = np.random.default_rng(1)
    blobs = np.concatenate([generator.normal(0, 0.1, (40, 3)), generator.normal(0, 0.1, (25, 3)) + 3.0, [[9.0, 9, 9]]])
    labels = dbscan(blobs, 0.5)
    assert set(labels[:40]) == {0} and set(labels[40:65]) == {1} and labels[65] == -1


def test_a_chain_is_one_cluster_and_a_thin_one_is_noise() -> None:
    chain = np.column_stack([np.arange(50) * 0.1, np.zeros((50, 2))])
    assert set(dbscan(chain, 0.25)) == {0}
    assert set(dbscan(chain, 0.05)) == {-1}
    assert list(dbscan(chain[:2], 1.0)) == [-1, -1]


def test_the_seed_is_the_crest_whatever_one_outlier_does() -> None:
    generator = np.random.default_rng(2)
    points, _ = close_up(Bolt(), generator)
    radii = np.hypot(points[:, 0], points[:, 1])[points[:, 2] < 30]
    assert crest_seed(radii, 0.03) == pytest.approx(3.9863, abs=0.004)
    assert crest_seed(np.append(radii, 9.0), 0.03) == pytest.approx(3.9863, abs=0.004)


@pytest.mark.parametrize("elevation_deg", [30.0, 45.0, 60.0])
def test_crest_recall_and_precision(elevation_deg: float) -> None:
    """The true band is known from the same rays without noise."""
    for seed in range(3):
        bolt = Bolt(pitch=1.2537)
        noisy, _ = close_up(bolt, np.random.default_rng(seed), elevation_deg=elevation_deg)
        exact, _ = close_up(bolt, np.random.default_rng(seed), elevation_deg=elevation_deg, sigma=0.0)
        side = (exact[:, 2] > 1.0) & (exact[:, 2] < 30.0)
        depth = 0.15 * bolt.pitch
        truth = np.hypot(exact[side, 0], exact[side, 1]) > bolt.radius - depth
        found, _ = crest_points(noisy[side], noise_mm=0.03, depth_mm=depth)
        both = np.count_nonzero(found & truth)
        assert both / np.count_nonzero(truth) >= 0.95
        assert both / np.count_nonzero(found) >= 0.95
