"""Faults on each bus, struck once at a moment that a seed draws: what must come of it, and that all is well again.

A strike is a function of a seed that raises where something is wrong: an error that is not the true one, something done
that nobody asked for or done twice, or a device that does not come back.
"""

from __future__ import annotations

from collections.abc import Callable

Strike = Callable[[int], None]
