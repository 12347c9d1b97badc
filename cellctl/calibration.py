"""What the controller believes about its cell: camera poses, table axis, jack line, force gain, artefact.

A belief with covariance, validity and id, read from a TOML file. It is never copied from the twin. Cell frame:
z up, origin on the table axis at the height of the shaft's face with the jack at 0; x and y along the stage.
Angles are right-handed about +z (the outward normal of the shaft's face).
"""

from __future__ import annotations

import hashlib
import json
import tomllib
from datetime import datetime
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from hal.errors import ConfigError
from hal.units import Deg, Fraction, Mm, Newton

Array = NDArray[np.float64]
Procedure = Literal["camera", "axes", "force"]
Matrix = tuple[tuple[float, ...], ...]
Vector = Annotated[tuple[Mm, Mm, Mm], Field(description="x, y, z in the cell frame")]
Row = tuple[float, float, float, float]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ViewCalibration(_Section):
    """Pose of the scanner in one view, `T_cell_scanner` (row major 4 x 4, mm), with one-sigma uncertainty per axis.

    `covariance` (6, 6), where it is given, says more than the two sigmas: turns about the scanner's place (deg, cell
    x, y, z), then shifts (mm), which a pose that was fitted at arm's length has in common.
    """

    T_cell_scanner: tuple[Row, Row, Row, Row]
    sigma_rotation_deg: Deg = Field(ge=0)
    sigma_translation_mm: Mm = Field(ge=0)
    covariance: Matrix | None = None

    @model_validator(mode="after")
    def _rigid(self) -> ViewCalibration:
        _check_covariance(self.covariance, 6)
        rotation = self.matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError("T_cell_scanner is not a right-handed rigid transform")
        return self

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) carrying scanner coordinates to cell coordinates."""
        return np.array(self.T_cell_scanner, dtype=np.float64)

    def errors(self) -> Array:
        """(6, k) independent errors of one sigma: turns in degrees, shifts in mm, both along cell x, y, z."""
        if self.covariance is not None:
            return _root(self.covariance)
        return np.diag([self.sigma_rotation_deg] * 3 + [self.sigma_translation_mm] * 3)


class AxisLine(_Section):
    """A line in the cell: the table's axis with the stage at 0, or the jack's travel, with one sigma per axis.

    `sigma_position_mm` is the place of the table's axis, or the straightness of the jack; `sigma_roll_deg` how far the
    jack turns what it carries about its own line over the stroke. `covariance` (4, 4), where it is given, holds for
    place (x, y, mm) and direction (turned about cell x, y, deg) instead; a jack has no place, so its rows are 0.
    """

    point_mm: Vector = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sigma_direction_deg: Deg = Field(default=0.0, ge=0)
    sigma_position_mm: Mm = Field(default=0.0, ge=0)
    sigma_roll_deg: Deg = Field(default=0.0, ge=0)
    covariance: Matrix | None = None

    @model_validator(mode="after")
    def _whole(self) -> AxisLine:
        _check_covariance(self.covariance, 4)
        return self

    def errors(self, *, placed: bool) -> Array:
        """(4, k) independent errors of one sigma: place x, y in mm (0 unless `placed`), turns about x and y in deg."""
        if self.covariance is not None:
            return _root(self.covariance)
        place = self.sigma_position_mm if placed else 0.0
        return np.diag([place, place, self.sigma_direction_deg, self.sigma_direction_deg])


class Stage(_Section):
    """Directions of the two stage axes in the cell frame, and how true the axes are, one sigma.

    `sigma_position_mm` and `sigma_table_deg` are the repeatability of stage and table; `sigma_encoder_deg` the rms over
    one turn of the table's error that comes back with each turn (eccentric scale), which two near angles share;
    `sigma_direction_deg` how well each of the two directions is known.
    """

    x_direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    y_direction: tuple[float, float, float] = (0.0, 1.0, 0.0)
    sigma_position_mm: Mm = Field(default=0.0, ge=0)
    sigma_table_deg: Deg = Field(default=0.0, ge=0)
    sigma_encoder_deg: Deg = Field(default=0.0, ge=0)
    sigma_direction_deg: Deg = Field(default=0.0, ge=0)


class ForceGain(_Section):
    """True force = gain x (reading - offset). `linearity` is the largest deviation from that, of the sensor's range."""

    gain: Fraction = Field(default=1.0, gt=0)
    sigma_gain: Fraction = Field(default=0.0, ge=0)
    offset_n: Newton = 0.0
    sigma_offset_n: Newton = Field(default=0.0, ge=0)
    linearity: Fraction = Field(default=0.0, ge=0)

    def true_n(self, reading_n: float) -> float:
        """The force behind a raw reading, newton."""
        return self.gain * (reading_n - self.offset_n)


class Artefact(_Section):
    """Certified sphere centres of the two-sided artefact on the bench, cell frame, millimetres.

    `sigma_mm` is the certificate's uncertainty of each coordinate, one sigma.
    """

    sphere_diameter_mm: Mm = Field(gt=0)
    sigma_mm: Mm = Field(default=0.0, ge=0)
    rotor_side_mm: tuple[Vector, ...] = Field(min_length=4)
    shaft_side_mm: tuple[Vector, ...] = Field(min_length=4)


class Scale(_Section):
    """From the scanner's certificate: relative scale error and ripple, one sigma."""

    sigma_scale: Fraction = Field(default=0.0, ge=0)
    sigma_ripple_mm: Mm = Field(default=0.0, ge=0)


class Made(_Section):
    """How one procedure came to its part of this file: when, with which devices, from how many stops, how well it fits.

    `figures` are residuals and what else the procedure saw, by name with its unit.
    """

    at: datetime
    devices: dict[str, str]
    stops: int = Field(ge=1)
    figures: dict[str, float] = Field(default_factory=dict)


class Calibration(_Section):
    """One calibration of one cell. `made` has an entry for each part that was measured on the cell itself."""

    id: str
    valid_from: datetime
    valid_until: datetime
    views: dict[Literal["rotor", "shaft"], ViewCalibration]
    table_axis: AxisLine
    jack_line: AxisLine
    stage: Stage = Stage()
    jack_force: ForceGain = ForceGain()
    scanner: Scale = Scale()
    artefact: Artefact
    made: dict[Procedure, Made] = Field(default_factory=dict)

    @property
    def content_hash(self) -> str:
        """SHA-256 of the canonical JSON."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()

    def valid_at(self, now: datetime) -> bool:
        """Whether the calibration may be used at `now` (aware, UTC)."""
        return self.valid_from <= now < self.valid_until


def _root(covariance: Matrix) -> Array:
    values, vectors = np.linalg.eigh(np.array(covariance, dtype=np.float64))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def _check_covariance(covariance: Matrix | None, size: int) -> None:
    if covariance is None:
        return
    if len(covariance) != size or any(len(row) != size for row in covariance):
        raise ValueError(f"covariance must be {size} x {size}")
    matrix = np.array(covariance, dtype=np.float64)
    values = np.linalg.eigvalsh(matrix)
    if not np.allclose(matrix, matrix.T, rtol=1e-6, atol=1e-15) or values[0] < -1e-9 * max(values[-1], 1e-30):
        raise ValueError("covariance is not symmetric and positive")


def load_calibration(path: Path) -> Calibration:
    """Calibration from a TOML file. Raises ConfigError with place and reason."""
    try:
        data = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise ConfigError(f"cannot be read: {error}", place=str(path)) from None
    try:
        return Calibration.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join([path.name, *(str(part) for part in first["loc"])])
        raise ConfigError(first["msg"], place=place) from None
