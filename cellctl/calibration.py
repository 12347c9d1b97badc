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
from hal.units import Deg, Fraction, Mm

Vector = Annotated[tuple[Mm, Mm, Mm], Field(description="x, y, z in the cell frame")]
Row = tuple[float, float, float, float]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class ViewCalibration(_Section):
    """Pose of the scanner in one view, `T_cell_scanner` (row major 4 x 4, mm), with one-sigma uncertainty per axis."""

    T_cell_scanner: tuple[Row, Row, Row, Row]
    sigma_rotation_deg: Deg = Field(ge=0)
    sigma_translation_mm: Mm = Field(ge=0)

    @model_validator(mode="after")
    def _rigid(self) -> ViewCalibration:
        rotation = self.matrix[:3, :3]
        if not np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-6) or np.linalg.det(rotation) < 0:
            raise ValueError("T_cell_scanner is not a right-handed rigid transform")
        return self

    @property
    def matrix(self) -> NDArray[np.float64]:
        """(4, 4) carrying scanner coordinates to cell coordinates."""
        return np.array(self.T_cell_scanner, dtype=np.float64)


class AxisLine(_Section):
    """A line in the cell: the table's axis with the stage at 0, or the jack's travel, with one sigma per axis.

    `sigma_position_mm` is the place of the table's axis, or the straightness of the jack; `sigma_roll_deg` how far the
    jack turns what it carries about its own line over the stroke.
    """

    point_mm: Vector = (0.0, 0.0, 0.0)
    direction: tuple[float, float, float] = (0.0, 0.0, 1.0)
    sigma_direction_deg: Deg = Field(default=0.0, ge=0)
    sigma_position_mm: Mm = Field(default=0.0, ge=0)
    sigma_roll_deg: Deg = Field(default=0.0, ge=0)


class Stage(_Section):
    """Directions of the two stage axes in the cell frame, and how true the axes are, one sigma.

    `sigma_position_mm` and `sigma_table_deg` are the repeatability of stage and table; `sigma_encoder_deg` the rms over
    one turn of the table's error that comes back with each turn (eccentric scale), which two near angles share.
    """

    x_direction: tuple[float, float, float] = (1.0, 0.0, 0.0)
    y_direction: tuple[float, float, float] = (0.0, 1.0, 0.0)
    sigma_position_mm: Mm = Field(default=0.0, ge=0)
    sigma_table_deg: Deg = Field(default=0.0, ge=0)
    sigma_encoder_deg: Deg = Field(default=0.0, ge=0)


class ForceGain(_Section):
    """True force = gain x reading."""

    gain: Fraction = Field(default=1.0, gt=0)
    sigma_gain: Fraction = Field(default=0.0, ge=0)


class Artefact(_Section):
    """Certified sphere centres of the two-sided artefact on the bench, cell frame, millimetres."""

    sphere_diameter_mm: Mm = Field(gt=0)
    rotor_side_mm: tuple[Vector, ...] = Field(min_length=4)
    shaft_side_mm: tuple[Vector, ...] = Field(min_length=4)


class Scale(_Section):
    """From the scanner's certificate: relative scale error and ripple, one sigma."""

    sigma_scale: Fraction = Field(default=0.0, ge=0)
    sigma_ripple_mm: Mm = Field(default=0.0, ge=0)


class Calibration(_Section):
    """One calibration of one cell."""

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

    @property
    def content_hash(self) -> str:
        """SHA-256 of the canonical JSON."""
        return hashlib.sha256(json.dumps(self.model_dump(mode="json"), sort_keys=True).encode()).hexdigest()

    def valid_at(self, now: datetime) -> bool:
        """Whether the calibration may be used at `now` (aware, UTC)."""
        return self.valid_from <= now < self.valid_until


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
