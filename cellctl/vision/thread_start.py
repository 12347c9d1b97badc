"""The way to a fit of threaded studs from a poor start, on some of the points: searches, then robust rounds. Pure."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.geometry import carried
from cellctl.vision.thread_noise import MIN_SIGMA_MM, SURELY_FLANK, NoiseLaw, learn, misfit, on_thread, scale_of, tukey
from cellctl.vision.thread_normal import Normal, Priors, lean_sigma
from cellctl.vision.thread_surface import FLANK, PITCH, RADIUS, Array, Depths, Form, Rays, depths

HELD_MM, HELD_ROUNDS = 1e-3, 4
"""The shared sizes stay at their start until the studs stand: freed at once, they may run off with the phases."""
ROUGH_POINTS, ROUGH_TOTAL = 72, 4000
"""Points of a stud, and of all studs where these are few, that bring the fit near."""
SEEKERS, SEEKERS_TOTAL = 36, 1200
"""The same for searches."""
RADIUS_CHANGES_MM = (0.0, -0.02, 0.02, -0.05, 0.05, -0.08, 0.08, -0.12, 0.12, -0.17)
STILL_MM, MOST = 4e-3, 0.8
WIDE = 4.0
"""Where rays graze, points miss by many sigma until the stud stands: the loss begins that much wider."""
FAR_OUT = 2.5
"""How many times more than drawn studs must seem to lean on some of the points to be let: noise that all points of a
stud share looks like a lean too. A smaller one is learnt from all points."""
POOR_SHARE, POORER = 0.3, 0.17
"""A stud is tried again where a larger share of its points does not fit, or so much more than of the usual stud."""


STEPS_MM = 0.12 * np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]])
"""Places about a likely one from which a stud is tried again."""
PHASES, LIKELY = 20, 12
"""Phases over a pitch that are looked at in each place; how many of the best are gone into."""


@dataclass(frozen=True, slots=True)
class Start:
    """Where the fit begins: `own` (n, OWN), `shared` (SHARED,), what is known of them, and the thread's form.

    `expected_mm` (n, 2) are the studs' nominal places, up to a motion of all together; None for a stud by itself.
    `noise_mm`: one sigma of the depths at least.
    """

    own: Array
    shared: Array
    priors: Priors
    form: Form
    expected_mm: Array | None = None
    noise_mm: float = MIN_SIGMA_MM

    def only(self, chosen: NDArray[np.intp], shared: Array) -> Start:
        """Some of the studs, as often as they are named, beside shared parameters at hand."""
        form = replace(self.form, tip_mm=self.form.tip_mm[chosen], extra_mm=self.form.extra_mm[chosen])
        return replace(self, own=self.own[chosen], shared=shared, form=form)


def seekers(rays: Rays) -> Rays:
    """As few points as a search needs."""
    return rays.take(thinned(rays.stud, max(SEEKERS, SEEKERS_TOTAL // max(len(np.unique(rays.stud)), 1))))


def near(rays: Rays, start: Start) -> tuple[Array, Array, NoiseLaw]:
    """Own and shared parameters near the optimum, and the law of the noise, from some of the points."""
    some = rays.take(thinned(rays.stud, max(ROUGH_POINTS, ROUGH_TOTAL // len(start.own))))
    few = some.take(thinned(some.stud, max(ROUGH_POINTS // 2, ROUGH_TOTAL // 2 // len(start.own))))
    own, shared, law = approach(few, start, start.own, start.shared, 0.25)
    own, shared, law = _tried_again(some, start, own, shared, law)
    own, shared, law = _other_radius(some, start, own, shared, law)
    law = learn(met := depths(some, own, shared, start.form), law, shared)
    lean_rad = lean_sigma(_normal(met, law, some.stud, len(own)), own, start.own, start.priors)
    if lean_rad > FAR_OUT * start.priors.own[2]:
        start = replace(start, priors=start.priors.leaning(lean_rad))
    wide = WIDE * law.scale_mm if law.growth < 1.0 else 0.0
    own, shared, law = approach(some, start, own, shared, wide, law=law, rounds=6, held=0)
    return _tried_again(some, start, own, shared, law)


def thinned(stud: NDArray[np.intp], most: int) -> NDArray[np.intp]:
    """Rows of at most about `most` evenly spread points of each stud; `stud` (N,) is sorted."""
    counts = np.bincount(stud)
    place = np.arange(len(stud)) - (np.cumsum(counts) - counts)[stud]
    step = np.maximum(1, -(-counts // most))[stud]
    return np.flatnonzero(place % step == 0)


def approach(
    rays: Rays, start: Start, own: Array, shared: Array, scale_mm: float, *, law: NoiseLaw | None = None,
    rounds: int = 16, held: int = HELD_ROUNDS, sure: bool = False,
) -> tuple[Array, Array, NoiseLaw]:  # fmt: skip
    """Gauss-Newton with Tukey weights whose scale falls from `scale_mm` to what the residuals show, or to the scale of
    `law` where that is `sure`."""
    held_priors = replace(start.priors, shared=np.minimum(start.priors.shared, HELD_MM))
    known, deepest = (start.own, start.shared), SURELY_FLANK * float(start.shared[PITCH])
    law = law or NoiseLaw(scale_mm, deepest, least_mm=start.noise_mm)
    least = law.scale_mm
    for turn in range(rounds):
        met = depths(rays, own, shared, start.form)
        wide = scale_mm * 0.5**turn if turn < 4 else 0.0
        law = replace(law, scale_mm=max(wide, least)) if sure else scale_of(met, law, wide)
        priors = held_priors if turn < held else start.priors
        d_own, d_shared = _normal(met, law, rays.stud, len(own)).step((own, shared), known, priors)
        own, shared = own + np.clip(d_own, -0.3, 0.3), shared + np.clip(d_shared, -0.1, 0.1)
        if turn > held + 1 and float(np.mean(np.abs(d_own[:, [0, 1, 4]]) < STILL_MM)) > MOST:
            break
    return own, shared, law


def _normal(met: Depths, law: NoiseLaw, stud: NDArray[np.intp], count: int) -> Normal:
    weights, sigmas = tukey(met, law)
    normal = Normal.empty(count)
    normal.add(met.rows / sigmas, weights, stud)
    return normal


def _tried_again(rays: Rays, start: Start, own: Array, shared: Array, law: NoiseLaw) -> tuple[Array, Array, NoiseLaw]:
    """Studs that do not fit, once more from other places and phases beside the sizes which the others found."""
    misfits = _misfit(rays, own, shared, start.form, law)
    poor = misfits > min(POOR_SHARE, float(np.median(misfits)) + POORER)
    if not poor.any() or not start.form.hand:
        return own, shared, law
    rows = np.flatnonzero(poor[rays.stud])
    once = Rays(rays.points[:, rows], rays.directions[:, rows], (np.cumsum(poor) - 1)[rays.stud[rows]])
    trials = _likeliest(
        once.take(thinned(once.stud, SEEKERS)), start, shared, _other_places(start, own, poor), np.flatnonzero(poor)
    )
    times, count = trials.shape[:2]
    some = _repeated(once, times, count)
    part = replace(start.only(np.tile(np.flatnonzero(poor), times), shared), own=trials.reshape(times * count, -1))
    # what does not fit says nothing about the noise
    found, _, _ = approach(some, part, part.own, shared, WIDE * law.scale_mm, law=law, rounds=9, held=9, sure=True)
    losses = _misfit(some, found, shared, part.form, law).reshape(times, count)
    best, each = np.argmin(losses, axis=0), np.arange(count)
    better = losses[best, each] < misfits[poor]
    own = own.copy()
    own[np.flatnonzero(poor)[better]] = found.reshape(trials.shape)[best, each][better]
    return own, shared, law


def _likeliest(rays: Rays, start: Start, shared: Array, places: Array, poor: NDArray[np.intp]) -> Array:
    """Own parameters (LIKELY, n, OWN) of the poor studs at the places (k, n, 2) and phases that look best."""
    studs, steps = len(poor), PHASES
    part = start.only(np.tile(poor, len(places)), shared)
    own = part.own.copy()
    own[:, :2] = places.reshape(-1, 2)
    phases = own[:, 4] + shared[PITCH] * np.arange(steps)[:, None] / steps
    costs = _trials(_repeated(rays, len(places), studs), own, shared, part.form, 4, phases)
    best = np.argsort(costs.reshape(-1, studs), axis=0, kind="stable")[:LIKELY]
    likely = own.reshape(len(places), studs, -1)[best % len(places), np.arange(studs)]
    likely[:, :, 4] += shared[PITCH] * (best // len(places)) / steps
    return likely


def _other_places(start: Start, own: Array, poor: NDArray[np.bool_]) -> Array:
    """Places (k, n, 2) at which the poor studs may stand: about where they began, and where the others say they are."""
    places = [start.own[poor, :2]]
    if start.expected_mm is not None and np.count_nonzero(~poor) >= 3:
        places.append(carried(start.expected_mm[poor], start.expected_mm[~poor], own[~poor, :2]))
    return np.concatenate([np.stack(places) + step for step in STEPS_MM])


def _other_radius(rays: Rays, start: Start, own: Array, shared: Array, law: NoiseLaw) -> tuple[Array, Array, NoiseLaw]:
    """The radius that fits best while the upper flanks stay where they are.

    Seen from above, a thread with too large a crest has its flanks in the right place and takes the crest's points for
    outliers: from there no small step leads on.
    """
    if not start.form.hand:
        return own, shared, law
    some = seekers(rays)
    losses = []
    for change in RADIUS_CHANGES_MM:
        met = depths(some, *_resized(own, shared, change), start.form, rows=False)
        losses.append(float(misfit(met, law).sum()))
    change = RADIUS_CHANGES_MM[int(np.argmin(losses))]
    if change == 0.0:
        return own, shared, law
    return approach(rays, start, *_resized(own, shared, change), 0.0, law=law, held=0)


def _resized(own: Array, shared: Array, change_mm: float) -> tuple[Array, Array]:
    """Other crest radius on the same upper flanks."""
    own, shared = own.copy(), shared.copy()
    shared[RADIUS] += change_mm
    own[:, 4] -= change_mm / FLANK
    return own, shared


def _misfit(rays: Rays, own: Array, shared: Array, form: Form, law: NoiseLaw) -> Array:
    """Share (n,) of each stud's points on thread and lead-in that do not fit."""
    met = depths(rays, own, shared, form, rows=False)
    on, (weights, _) = on_thread(met, law.deepest_mm), tukey(met, law)
    there = np.bincount(rays.stud[on], minlength=len(own))
    return np.asarray(np.bincount(rays.stud[on & (weights == 0.0)], minlength=len(own)) / np.maximum(there, 1))


def best_phase(rays: Rays, own: Array, shared: Array, form: Form, *, steps: int = 16) -> Array:
    """Phase (n,) in mm that fits each stud best among `steps` over one pitch, by a bounded cost."""
    phases = own[:, 4] + shared[PITCH] * np.arange(steps)[:, None] / steps
    costs = _trials(rays, own, shared, form, 4, phases)
    return np.asarray(phases[np.argmin(costs, axis=0), np.arange(len(own))])


def best_lead_in(rays: Rays, own: Array, shared: Array, form: Form, depths_mm: Array) -> float:
    """How far below the tip the lead-in begins, among `depths_mm`: the same for all studs."""
    costs = _trials(rays, own, shared, form, 5, form.tip_mm - depths_mm[:, None])
    return float(depths_mm[int(np.argmin(costs.sum(axis=1)))])


def _trials(rays: Rays, own: Array, shared: Array, form: Form, which: int, values: Array) -> Array:
    """Costs (k, n) of each stud with each of the `values` (k, n) for one of its parameters, all in one go."""
    trials = len(values)
    own = np.tile(own, (trials, 1))
    own[:, which] = values.ravel()
    form = replace(form, tip_mm=np.tile(form.tip_mm, trials), extra_mm=np.tile(form.extra_mm, trials))
    return _cost(_repeated(rays, trials, values.shape[1]), own, shared, form).reshape(values.shape)


def _repeated(rays: Rays, times: int, studs: int) -> Rays:
    """The same rays again and again, each time on `studs` further ones."""
    stud = (rays.stud + studs * np.arange(times)[:, None]).ravel()
    return Rays(np.tile(rays.points, times), np.tile(rays.directions, times), stud)


def _cost(rays: Rays, own: Array, shared: Array, form: Form) -> Array:
    """Bounded misses across the surface, summed over the points of each stud (n,)."""
    met = depths(rays, own, shared, form, rows=False)
    miss = np.minimum(np.abs(np.nan_to_num(met.ahead_mm, nan=9.0)) * met.cosine, 0.3)
    return np.bincount(rays.stud, np.where(on_thread(met, np.inf), miss, 0.3), len(own)).astype(np.float64)
