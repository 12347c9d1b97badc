"""What heat and nuts must offer the plant, and the plainest of each: a bench without a heater, studs without nuts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from hal.fake.parts import ShaftTruth

Array = NDArray[np.float64]


class ThermalTruth(Protocol):
    """Heat of the joint. Another shaft or rotor comes at the temperature of the room."""

    @property
    def shaft_c(self) -> float: ...
    @property
    def rotor_c(self) -> float: ...
    @property
    def interference_mm(self) -> float:
        """Present diametral interference of the spigot; negative is clearance."""
        ...

    @property
    def circle_growth(self) -> float:
        """Relative growth of the hole circle against the stud circle."""
        ...

    def advance(self, now: float, gap_mm: float) -> None:
        """Integrate to `now`; `gap_mm` is the present distance of the faces (the spigot engages below its length)."""
        ...


class JointsTruth(Protocol):
    """The nuts."""

    def preload_n(self) -> Array:
        """(n,) present preload of each stud."""
        ...

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) studs beyond yield, or threads stripped."""
        ...


class Isothermal:
    """Both members at one temperature: a bench without a heater."""

    circle_growth = 0.0

    def __init__(self, temperature_c: float, part: Callable[[], ShaftTruth]) -> None:
        self.shaft_c = temperature_c
        self.rotor_c = temperature_c
        self._part = part

    @property
    def interference_mm(self) -> float:
        """That of the drawing's temperature: both members grow alike."""
        return self._part().interference_mm

    def advance(self, now: float, gap_mm: float) -> None:
        """Nothing changes."""


class Loose:
    """Studs without nuts."""

    def __init__(self, count: int) -> None:
        self._count = count

    def preload_n(self) -> Array:
        """(n,) zeros."""
        return np.zeros(self._count)

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) false."""
        return np.zeros(self._count, dtype=bool)
