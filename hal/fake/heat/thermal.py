"""Heat in the joint: four zones, the spigot's air gap, the faces, loss to the room. Pure functions on frozen data.

Each member has a thin rim that carries the spigot and a body (flange or disc) behind a neck: rims follow the spigot's
gap within seconds, bodies follow the room within half an hour. Temperatures in degrees Celsius, powers in watts.

Film between two surfaces (Holman, Heat Transfer, 2.11; VDI Heat Atlas, K): h = k_air / gap, where the mean gap never
falls below the surfaces' own form error; h = contact conductance once the fit has closed. A male that lies on one side
of its bore (it always does) has the conductance of the eccentric annulus:  mean of 1 / (g + d + g cos phi) over phi
is 1 / sqrt((g + d)^2 - g^2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

Member = Literal["shaft", "rotor"]


VOLUMETRIC_J_PER_K_MM3 = 8.19e-6 * 435.0
"""Nickel alloy 718: 8.19 g/cm3, 435 J/(kg K)."""


class Zones(NamedTuple):
    """Temperatures of the four zones."""

    shaft_rim_c: float
    shaft_flange_c: float
    rotor_rim_c: float
    rotor_disc_c: float


@dataclass(frozen=True, slots=True)
class ThermalProperties:
    """Heat capacities, conductances and sizes. Rims: nickel alloy, 8.5 mm x 3 mm ring on 180 mm, 435 J/(kg K)."""

    ambient_c: float = 20.0
    rim_j_per_k: float = 50.0
    flange_j_per_k: float = 1800.0
    """Ring 180 to 280 mm, 14 mm thick."""
    disc_j_per_k: float = 3600.0
    neck_w_per_k: float = 2.0
    """Rim to body: 12 W/(m K), 3 mm thick, 10 mm long."""
    loss_time_s: float = 1800.0
    """Capacity over loss conductance of every zone."""
    spigot_diameter_mm: float = 180.0
    spigot_length_mm: float = 3.0
    face_inner_diameter_mm: float = 180.0
    face_outer_diameter_mm: float = 280.0
    air_w_per_m_k: float = 0.027
    """At 50 C."""
    spigot_form_mm: float = 0.025
    """Mean distance of the spigot's lands when the fit is line to line: roundness, roughness, temperature jump."""
    face_form_mm: float = 0.025
    """Mean distance of the faces when they touch: half of their flatness."""
    contact_w_per_m2_k: float = 3000.0
    """Dry metal at light pressure in air (VDI Heat Atlas)."""
    expansion_per_k: float = 12.5e-6
    interference_mm: float = 0.060
    """Diametral, both members at one temperature."""
    heated: Member = "shaft"
    rim_share: float = 0.05
    """Share of the heater's power that enters at the rim, the rest at the body."""

    @property
    def heated_j_per_k(self) -> float:
        """Heat capacity of the member that the heater heats."""
        return self.rim_j_per_k + (self.flange_j_per_k if self.heated == "shaft" else self.disc_j_per_k)


def ring_j_per_k(inner_mm: float, outer_mm: float, thick_mm: float) -> float:
    """Heat capacity of a flat ring of nickel alloy between two diameters."""
    return VOLUMETRIC_J_PER_K_MM3 * math.pi / 4.0 * (outer_mm**2 - inner_mm**2) * thick_mm


def at_rest(properties: ThermalProperties) -> Zones:
    """Everything at the temperature of the room."""
    return Zones(*(properties.ambient_c,) * 4)


def interference_mm(properties: ThermalProperties, zones: Zones) -> float:
    """Present diametral interference I_20 - alpha D (T_bore - T_male); negative is clearance.

    The heated member has the bore.
    """
    difference = zones.shaft_rim_c - zones.rotor_rim_c
    if properties.heated == "rotor":
        difference = -difference
    return properties.interference_mm - properties.expansion_per_k * properties.spigot_diameter_mm * difference


def circle_growth(properties: ThermalProperties, zones: Zones) -> float:
    """Relative growth of the shaft's hole circle against the rotor's stud circle (times the radius: mm)."""
    return properties.expansion_per_k * (zones.shaft_flange_c - zones.rotor_disc_c)


def film_w_per_m2_k(properties: ThermalProperties, gap_mm: float, form_mm: float) -> float:
    """Conductance between surfaces whose mean gap is `gap_mm` on top of `form_mm`, lying on one side."""
    return properties.air_w_per_m_k * 1e3 / math.sqrt((gap_mm + form_mm) ** 2 - gap_mm**2)


def spigot_w_per_k(properties: ThermalProperties, engaged_mm: float, interference_now_mm: float) -> float:
    """Conductance rim to rim over the engaged cylinder."""
    engaged_mm = min(max(engaged_mm, 0.0), properties.spigot_length_mm)
    area_m2 = math.pi * properties.spigot_diameter_mm * engaged_mm * 1e-6
    radial_gap_mm = 0.5 * max(-interference_now_mm, 0.0)
    film = film_w_per_m2_k(properties, radial_gap_mm, properties.spigot_form_mm)
    return area_m2 * (max(film, properties.contact_w_per_m2_k) if interference_now_mm >= 0.0 else film)


def faces_w_per_k(properties: ThermalProperties, face_gap_mm: float) -> float:
    """Conductance face to face through the air between them; parallel plates, so the plain k / gap."""
    area_m2 = 0.25e-6 * math.pi * (properties.face_outer_diameter_mm**2 - properties.face_inner_diameter_mm**2)
    return area_m2 * properties.air_w_per_m_k * 1e3 / (max(face_gap_mm, 0.0) + properties.face_form_mm)


def rates(properties: ThermalProperties, zones: Zones, power_w: float, face_gap_mm: float) -> Zones:
    """Time derivatives of the zones in K/s while `power_w` enters the heated member at a face gap of `face_gap_mm`."""
    shaft_rim, flange, rotor_rim, disc = zones
    engaged_mm = properties.spigot_length_mm - face_gap_mm
    across = (shaft_rim - rotor_rim) * (
        spigot_w_per_k(properties, engaged_mm, interference_mm(properties, zones)) if engaged_mm > 0.0 else 0.0
    )
    faces = (flange - disc) * faces_w_per_k(properties, face_gap_mm)
    shaft_neck = properties.neck_w_per_k * (flange - shaft_rim)
    rotor_neck = properties.neck_w_per_k * (disc - rotor_rim)
    at_rim, at_body = power_w * properties.rim_share, power_w * (1.0 - properties.rim_share)
    on_shaft = properties.heated == "shaft"
    loss = 1.0 / properties.loss_time_s
    ambient = properties.ambient_c
    return Zones(
        (shaft_neck - across + (at_rim if on_shaft else 0.0)) / properties.rim_j_per_k - loss * (shaft_rim - ambient),
        (-shaft_neck - faces + (at_body if on_shaft else 0.0)) / properties.flange_j_per_k - loss * (flange - ambient),
        (rotor_neck + across + (0.0 if on_shaft else at_rim)) / properties.rim_j_per_k - loss * (rotor_rim - ambient),
        (-rotor_neck + faces + (0.0 if on_shaft else at_body)) / properties.disc_j_per_k - loss * (disc - ambient),
    )


def step(properties: ThermalProperties, zones: Zones, power_w: float, face_gap_mm: float, dt_s: float) -> Zones:
    """One Runge-Kutta step of fourth order; stable up to some 5 s, accurate to 1 mK below 1 s."""
    a = rates(properties, zones, power_w, face_gap_mm)
    b = rates(properties, _shifted(zones, a, 0.5 * dt_s), power_w, face_gap_mm)
    c = rates(properties, _shifted(zones, b, 0.5 * dt_s), power_w, face_gap_mm)
    d = rates(properties, _shifted(zones, c, dt_s), power_w, face_gap_mm)
    sixth = dt_s / 6.0
    return Zones(*(t + sixth * (i + 2 * j + 2 * k + m) for t, i, j, k, m in zip(zones, a, b, c, d, strict=True)))


def midpoint(properties: ThermalProperties, zones: Zones, power_w: float, face_gap_mm: float, dt_s: float) -> Zones:
    """One step of second order, for a look between two steps of the grid."""
    if dt_s <= 0.0:
        return zones
    halfway = _shifted(zones, rates(properties, zones, power_w, face_gap_mm), 0.5 * dt_s)
    return _shifted(zones, rates(properties, halfway, power_w, face_gap_mm), dt_s)


def _shifted(zones: Zones, rate: Zones, dt_s: float) -> Zones:
    return Zones(
        zones[0] + dt_s * rate[0], zones[1] + dt_s * rate[1], zones[2] + dt_s * rate[2], zones[3] + dt_s * rate[3]
    )


def lagged(value: float, source: float, time_constant_s: float, dt_s: float) -> float:
    """First-order lag towards a constant `source`, exact over `dt_s`."""
    return source + (value - source) * math.exp(-dt_s / time_constant_s) if time_constant_s > 0 else source


def step_response(time_s: float, rise: float, time_constant_s: float, dead_time_s: float) -> float:
    """First order plus dead time: what a heater with a sensor answers to a step at time 0."""
    return rise * (1.0 - math.exp(-max(time_s - dead_time_s, 0.0) / time_constant_s))


def pyrometer_c(true_c: float, ambient_c: float, emissivity: float, set_emissivity: float) -> float:
    """What a total-radiation pyrometer shows that believes in `set_emissivity`.

    It sees e T^4 + (1 - e) T_room^4 and solves for T with its own e (Stefan-Boltzmann, kelvin).
    """
    target, room = (true_c + 273.15) ** 4, (ambient_c + 273.15) ** 4
    seen = emissivity * target + (1.0 - emissivity) * room
    own = max((seen - (1.0 - set_emissivity) * room) / set_emissivity, 0.0)
    return math.sqrt(math.sqrt(own)) - 273.15
