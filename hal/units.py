"""Number types that carry their unit into every schema (recipe, cell file, REST).

Each is a finite float; the unit stands in the JSON schema as ``unit`` (UCUM-like symbols).
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field


def _unit(symbol: str) -> object:
    return Field(json_schema_extra={"unit": symbol}, allow_inf_nan=False)


Mm = Annotated[float, _unit("mm")]
Deg = Annotated[float, _unit("deg")]
Newton = Annotated[float, _unit("N")]
NewtonPerMm = Annotated[float, _unit("N/mm")]
NewtonMetre = Annotated[float, _unit("N.m")]
Celsius = Annotated[float, _unit("Cel")]
Kelvin = Annotated[float, _unit("K")]
KelvinPerMinute = Annotated[float, _unit("K/min")]
Seconds = Annotated[float, _unit("s")]
MmPerSecond = Annotated[float, _unit("mm/s")]
MmPerSecond2 = Annotated[float, _unit("mm/s2")]
DegPerSecond = Annotated[float, _unit("deg/s")]
Rpm = Annotated[float, _unit("1/min")]
Kilogram = Annotated[float, _unit("kg")]
Watt = Annotated[float, _unit("W")]
Bar = Annotated[float, _unit("bar")]
PerKelvin = Annotated[float, _unit("1/K")]
Fraction = Annotated[float, _unit("1")]

GRAVITY_M_S2 = 9.80665
"""Standard acceleration of free fall (3rd CGPM, 1901)."""
