"""Where the shaft has to go: two measured parts and the calibration in, one `Alignment` with its covariance out."""

from cellctl.docking.align import align
from cellctl.docking.alignment import Alignment, AlignSpec, Station, align_spec

__all__ = ["AlignSpec", "Alignment", "Station", "align", "align_spec"]
