"""Calibration of a cell on the cell itself: steps that look and move, pure functions that compute, one file that comes
of it. `camera`, `table`, `jack` and `force` are pure."""
