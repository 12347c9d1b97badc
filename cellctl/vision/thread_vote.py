"""Pitch, hand, starts and phase of threads by a vote of all points (eq. 12, 13, corrected). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from cellctl.vision.part import Refused, Thread

Array = NDArray[np.float64]

CELLS_A_PITCH = 8.0
"""Cells of the height axis in the finest pitch that is voted for."""
LEAST_SCORE = 0.05
PITCH_SHARE = 0.03
"""By how much of itself a pitch may differ from the expected one."""
IN_DOUBT = 0.25
"""Standard deviations of chance by which another thread must lie above the expected one to speak against it."""


@dataclass(frozen=True, slots=True)
class ThreadVote:
    """Winner of the vote. `score` is its share of all the power (0 to 1) beyond what chance gives, `rival` the other
    hand's best over it.

    `phase_mm` (n,) is where the points of each stud crowd at angle 0, as a height within one pitch: the crest, or
    beside it where only one flank is seen.
    """

    pitch_mm: float
    hand: Literal["right", "left"]
    starts: int
    score: float
    rival: float
    phase_mm: Array


def vote(
    radius_mm: Array,
    angle_rad: Array,
    height_mm: Array,
    stud: NDArray[np.intp],
    count: int,
    *,
    pitch_low_mm: float = 0.4,
    pitch_high_mm: float = 3.0,
    max_starts: int = 3,
    expected: Thread | None = None,
) -> ThreadVote:
    """Vote over pitch, phase, hand and starts with the height taken modulo the pitch.

    A point of radius R = hypot(x, y) at angle theta = atan2(y, x) and height z (eq. 13; the paper's arctan(y/x) wraps
    at 90 degrees) lies on a crest where z = lead theta / 2 pi + phase modulo the pitch. Points vote twice: by being
    there at all, because a thread hides its own valleys, and by their radius above the stud's median. For every hand
    and number of starts the votes are summed over the phase with a Fourier transform along z; studs of different
    phase add their power.
    """
    cell = pitch_low_mm / CELLS_A_PITCH
    cells = int(2 ** np.ceil(np.log2(max(64.0, 2.0 * (np.ptp(height_mm) + 1.0) / cell))))
    bins = ((height_mm - height_mm.min()) * (1.0 / cell)).astype(np.intp)
    frequency = np.arange(cells // 2) / (cells * cell)
    band = np.flatnonzero((frequency >= 1.0 / pitch_high_mm) & (frequency <= 1.0 / pitch_low_mm))
    places = stud * cells + bins
    voices = (_presence(stud, count), _radii(radius_mm, stud, count))
    powers: dict[int, Array] = {}
    for turns in range(1, max_starts + 1):
        cosine, sine = np.cos(turns * angle_rad), np.sin(turns * angle_rad)
        powers[turns], powers[-turns] = np.zeros(len(band)), np.zeros(len(band))
        for voice in voices:
            real = np.bincount(places, voice * cosine, count * cells).reshape(count, cells)
            imag = np.bincount(places, voice * sine, count * cells).reshape(count, cells)
            spectrum = np.abs(np.fft.fft(real + 1j * imag, axis=1)) ** 2
            # voices are real: what turns the other way stands at the negative frequencies
            powers[turns] += spectrum[:, band].sum(axis=0)
            powers[-turns] += spectrum[:, -band].sum(axis=0)
    tallest = max(powers, key=lambda turns: (float(powers[turns].max()), turns))
    turns, at = _fundamental(powers, tallest, band, 2.0 * count)
    if expected is not None:
        turns, at = _in_doubt(powers, frequency[band], (turns, at), expected)
    power = max(float(powers[turns][at]), 1e-300)
    rivals = max(float(other.max()) for key, other in powers.items() if key * turns < 0)
    pitch = 1.0 / _peak(frequency[band], powers[turns], at)
    argument = height_mm * (2.0 * np.pi / pitch) - turns * angle_rad
    crowd = voices[0] + voices[1]
    sums = np.bincount(stud, crowd * np.cos(argument), count) + 1j * np.bincount(stud, crowd * np.sin(argument), count)
    return ThreadVote(
        pitch_mm=pitch,
        hand="right" if turns > 0 else "left",
        starts=abs(turns),
        score=_beyond_chance(power / (2.0 * len(stud)), count / len(stud)),
        rival=rivals / power,
        phase_mm=np.angle(sums) / (2.0 * np.pi) * pitch,
    )


def shows(ballot: ThreadVote) -> bool:
    """Whether there is a thread at all."""
    return ballot.score > LEAST_SCORE


def check_vote(ballot: ThreadVote, expected: Thread, where: str = "") -> None:
    """Refuse (thread_wrong) another thread than the expected one, or none at all."""
    if not shows(ballot):
        raise Refused("thread_wrong", f"{where}no thread shows (vote {ballot.score:.3f})")
    same = ballot.hand == expected.hand and ballot.starts == expected.starts
    if not same or abs(ballot.pitch_mm - expected.pitch_mm) > PITCH_SHARE * expected.pitch_mm:
        raise Refused(
            "thread_wrong",
            f"{where}{ballot.hand}-hand thread of pitch {ballot.pitch_mm:.2f} mm, {ballot.starts} start(s); "
            f"the recipe says {expected.hand}-hand, {expected.pitch_mm:g} mm, {expected.starts} start(s)",
        )


def _fundamental(powers: dict[int, Array], turns: int, band: NDArray[np.intp], chance: float) -> tuple[int, int]:
    """Turns and place in the band of the thread itself: the overtones of a single start look like more starts.

    `chance` is the power that points without any order have.
    """
    at = int(powers[turns].argmax())
    for part in range(abs(turns), 1, -1):
        if turns % part:
            continue
        low = int(np.searchsorted(band, band[at] / part - 2.0))
        window = powers[turns // part][low : low + 5]
        if len(window) and window.max() - chance > 0.15 * (powers[turns][at] - chance):
            return turns // part, low + int(window.argmax())
    return turns, at


def _in_doubt(powers: dict[int, Array], frequency: Array, winner: tuple[int, int], expected: Thread) -> tuple[int, int]:
    """The expected thread where it lies hardly below the winner, else the winner.

    Unit power of chance in each quadrature pair changes a power P by 2 sqrt(P / 2).
    """
    turns = expected.starts if expected.hand == "right" else -expected.starts
    near = np.flatnonzero(np.abs(frequency * expected.pitch_mm - 1.0) <= PITCH_SHARE)
    if turns not in powers or not len(near):
        return winner
    at = int(near[powers[turns][near].argmax()])
    most = float(powers[winner[0]][winner[1]])
    return (turns, at) if powers[turns][at] > most - IN_DOUBT * np.sqrt(2.0 * most) else winner


def _beyond_chance(share: float, chance: float) -> float:
    """Share of the power that points without any order, `chance` of it each, would not have."""
    return max(0.0, share - chance) / max(1.0 - chance, 1e-9)


def _presence(stud: NDArray[np.intp], count: int) -> Array:
    """One vote a point, of unit power for each stud's point."""
    points = np.bincount(stud, minlength=count)
    return np.asarray(1.0 / np.sqrt(np.maximum(points, 1.0)))[stud]


def _radii(radius: Array, stud: NDArray[np.intp], count: int) -> Array:
    """Radius above each stud's median, bounded so that no outlier shouts, of unit power for each stud's point."""
    voice = np.zeros(len(radius))
    for i in range(count):
        mine = np.flatnonzero(stud == i)
        if len(mine):
            above = radius[mine] - np.median(radius[mine])
            bound = 3.0 * 1.4826 * float(np.median(np.abs(above))) + 1e-9
            above = np.clip(above, -bound, bound)
            voice[mine] = above / (float(np.linalg.norm(above)) + 1e-12)
    return voice


def _peak(frequency: Array, power: Array, at: int) -> float:
    """Frequency of the maximum by a parabola through its three cells."""
    if not 0 < at < len(power) - 1:
        return float(frequency[at])
    a, b, c = power[at - 1 : at + 2]
    shift = 0.5 * (a - c) / (a - 2 * b + c) if a - 2 * b + c < 0 else 0.0
    return float(frequency[at] + shift * (frequency[1] - frequency[0]))
