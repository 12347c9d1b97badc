"""The plant's nuts and guns: what is on each stud, what each socket does to it. Advanced lazily.

How fakes and the plant's owner use it::

    joints.load_nut("a"); joints.socket_has_nut("a")         # the nut feeder
    joints.force_n("a", times_s)                              # contact force sensor of a gun
    joints.plan_turn("a", 720.0, 6.0, now) -> Turn; joints.apply("a", turn)
    joints.begin("a", key, program, now) -> ActiveRun; joints.stop("a", now); joints.advance(now)
    joints.preload_n(), joints.yielded()                      # truth
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from hal.fake.joints import gun_bench
from hal.fake.joints.curve import Curve, free_spin, loosening, tightening
from hal.fake.joints.gun_bench import GunBench
from hal.fake.joints.gun_memory import ActiveRun, GunMemory, GunName
from hal.fake.joints.joint import NutState
from hal.fake.joints.nuts import Error, Nuts
from hal.fake.joints.tightening import GunProperties, drive, evaluate, slipping, turned
from hal.fake.plant import Plant
from hal.interfaces import Band, TighteningProgram, TighteningResult

Array = NDArray[np.float64]


BY_HAND_GAP_MM = 0.5
"""The operator comes when the faces are together."""


@dataclass(frozen=True, slots=True)
class Turn:
    """What a slow turn does: spindle angle (signed), largest torque, and the state after it."""

    spindle_deg: float
    peak_nm: float
    joint: int | None = None
    nut: NutState | None = None
    takes_nut: bool | None = None
    """True: the nut leaves the socket for the stud; False: it comes back into the socket."""
    reverses: bool = False


class Joints:
    """Nuts and guns of one plant."""

    def __init__(
        self,
        plant: Plant,
        bench: GunBench | None = None,
        gun: GunProperties | None = None,
        *,
        nuts_by_hand: bool = False,
    ) -> None:
        """With `nuts_by_hand` an operator puts a nut on every stud, two turns deep, once the studs are through."""
        self.bench = bench or GunBench()
        self.gun = gun or GunProperties()
        self._plant = plant
        self.guns: dict[str, GunMemory] = {"a": GunMemory("a"), "b": GunMemory("b")}
        self._nuts_by_hand = nuts_by_hand
        self.nuts = Nuts(plant)
        self.properties = self.nuts.properties

    def _renew(self) -> None:
        """Other parts come with bare studs and empty sockets."""
        if self.nuts.shaft is not self._plant.shaft:
            self.nuts = Nuts(self._plant)
            for memory in self.guns.values():
                memory.nut_in_socket = memory.reversed_on_stud = False

    def _follow_parts(self) -> None:
        """As `_renew`, and the operator's nuts where they are due."""
        self._renew()
        if self._nuts_by_hand and not self.nuts.started_by_hand and self._plant.gap_mm() < BY_HAND_GAP_MM:
            self.nuts.start_by_hand()

    # ------------------------------------------------------------ truth

    def preload_n(self) -> Array:
        """(n,) present preload of each stud."""
        self._renew()
        return self.nuts.preload_n()

    def yielded(self) -> NDArray[np.bool_]:
        """(n,) studs beyond yield, threads stripped or crossed."""
        self._renew()
        return self.nuts.yielded()

    def plant_error(self, joint: int, error: Error) -> None:
        """Plant an error in one joint; it strikes when the gun comes to it."""
        self._follow_parts()
        self.nuts.planted.setdefault(joint, set()).add(error)

    # ------------------------------------------------------------ sockets

    def socket_has_nut(self, gun: GunName) -> bool:
        """Whether a nut is in the socket and not on a stud."""
        self._follow_parts()
        return self.guns[gun].nut_in_socket

    def load_nut(self, gun: GunName) -> None:
        """The feeder puts a nut into the socket."""
        self._follow_parts()
        self.guns[gun].nut_in_socket, self.guns[gun].reversed_on_stud = True, False

    def joint_at(self, gun: GunName, now: float) -> int | None:
        """The joint that the gun stands under."""
        radius = 0.5 * self._plant.geometry.circle_diameter_mm
        return gun_bench.facing(self.bench, self.nuts.stud_end_mm[:, :2], radius, self._gun_deg(gun, now))

    def contact_mm(self, gun: GunName, now: float) -> float:
        """Feed at which the gun's slide is fully in on whatever is before the socket."""
        joint, memory, sizes = self.joint_at(gun, now), self.guns[gun], self.properties
        geometry = self._plant.geometry
        gap = self._plant.gap_mm()
        flange_mm = self._plant.bench.rotor_face_mm - gap - geometry.hole_depth_mm
        if joint is None or self.nuts.stud_end_mm[joint, 2] > flange_mm - sizes.pitch_mm:
            return flange_mm - self.bench.mouth_mm
        end_mm = float(self.nuts.stud_end_mm[joint, 2])
        nut, proud_mm = self.nuts.state[joint], sizes.nut_height_mm - self.bench.hex_depth_mm
        if memory.nut_in_socket:
            top_mm = end_mm if not nut.present else end_mm + nut.climb_mm - sizes.nut_height_mm
            return top_mm - proud_mm - self.bench.mouth_mm
        if not nut.present:
            return flange_mm - self.bench.mouth_mm
        edge_mm = end_mm + nut.climb_mm - sizes.nut_height_mm
        on_hex = gun_bench.fits(self.bench, nut.hex_deg, self._socket_deg(gun, now))
        return edge_mm + (self.bench.hex_depth_mm if on_hex else 0.0) - self.bench.mouth_mm

    def force_n(self, gun: GunName, times_s: Array) -> Array:
        """(n,) contact force at `times_s`, with the sockets as they are now and the feed as it will move."""
        self._follow_parts()
        feed = self._plant.motion["gun_feed"].positions(times_s)
        contact_mm = self.contact_mm(gun, float(times_s[0]))
        if contact_mm < 0.0:  # the flange has not come up to the sockets yet: there is nothing before them
            return np.zeros_like(feed)
        force = gun_bench.force_n(self.bench, feed, contact_mm)
        if force.size and float(force[0]) > self.bench.crush_n:
            self._plant.damage(f"gun {gun} pressed with more than {self.bench.crush_n:.0f} N")
        return force

    def _force_now_n(self, gun: GunName, now: float) -> float:
        return float(self.force_n(gun, np.array([now]))[0])

    def _gun_deg(self, gun: GunName, now: float) -> float:
        return self._plant.motion["gun_table"].position(now) + (180.0 if gun == "b" else 0.0)

    def _socket_deg(self, gun: GunName, now: float) -> float:
        """Orientation of the socket's hex in the cell."""
        return self._gun_deg(gun, now) + self.properties.hand * self.guns[gun].spindle_deg

    # ------------------------------------------------------------ slow turns

    def plan_turn(self, gun: GunName, angle_deg: float, limit_nm: float, now: float) -> Turn:
        """What a turn by `angle_deg` (positive tightens) would do, stopped early at `limit_nm`. Changes nothing."""
        self.advance(now)
        joint, memory = self.joint_at(gun, now), self.guns[gun]
        force = self._force_now_n(gun, now)
        if joint is None or force < gun_bench.CONTACT_N:
            return Turn(angle_deg, 0.3 * self.properties.free_torque_nm)
        nut = self.nuts.state[joint]
        if memory.nut_in_socket:
            return self._start_thread(gun, joint, angle_deg, limit_nm, force)
        if not nut.present:
            return Turn(angle_deg, self.bench.rubbing_nm)
        sense = 1.0 if angle_deg >= 0.0 else -1.0
        free = self._free_deg(gun, nut, now, sense)
        if abs(angle_deg) <= free:
            return Turn(angle_deg, self.bench.rubbing_nm)
        return self._turn_nut(joint, nut, sense, abs(angle_deg), free, limit_nm)

    def _free_deg(self, gun: GunName, nut: NutState, now: float, sense: float) -> float:
        """What the socket turns in the gun's `sense` until it drops over the hex; 0 when it is on already."""
        socket = self._socket_deg(gun, now)
        if gun_bench.fits(self.bench, nut.hex_deg, socket):
            return 0.0
        forward = gun_bench.misfit_deg(self.bench, nut.hex_deg, socket)
        return forward if sense * self.properties.hand > 0 else self.bench.hex_pitch_deg - forward

    def _start_thread(self, gun: GunName, joint: int, angle_deg: float, limit_nm: float, force: float) -> Turn:
        if force < self.bench.start_n or self.nuts.state[joint].present:
            return Turn(angle_deg, self.bench.rubbing_nm)
        if angle_deg < 0.0:
            return Turn(angle_deg, self.bench.rubbing_nm, reverses=True)
        memory = self.guns[gun]
        rng = self.nuts.rng("thread", joint)
        ready = memory.reversed_on_stud
        free = float(rng.uniform(5.0, 25.0) if ready else rng.uniform(0.0, 360.0))
        askew = "cross_thread" in self.nuts.planted.get(joint, ()) or (not ready and rng.random() < 0.05)
        if angle_deg <= free:
            return Turn(angle_deg, self.bench.rubbing_nm)
        nut = replace(self.nuts.fresh(joint, 0.0), crossed=askew)
        turn = self._turn_nut(joint, nut, 1.0, angle_deg, free, limit_nm)
        return replace(turn, takes_nut=True)

    def _turn_nut(
        self, joint: int, nut: NutState, sense: float, angle_deg: float, free_deg: float, limit_nm: float
    ) -> Turn:
        condition = self.nuts.condition(joint)
        curve = (tightening if sense > 0 else loosening)(self.properties, nut, condition)
        spindle, rotation, preload, peak = turned(curve, angle_deg - free_deg, limit_nm, self.gun)
        moved = self.nuts.moved(nut, sense * rotation, preload)
        back = sense < 0 and moved is None
        return Turn(sense * (free_deg + spindle), peak, joint, moved or NutState(), False if back else None)

    def apply(self, gun: GunName, turn: Turn, now: float) -> None:
        """Make a planned turn true."""
        memory = self.guns[gun]
        memory.spindle_deg += turn.spindle_deg
        memory.reversed_on_stud = turn.reverses or (memory.reversed_on_stud and turn.takes_nut is None)
        if turn.takes_nut is not None:
            memory.nut_in_socket = not turn.takes_nut
        if turn.joint is not None and turn.nut is not None:
            self.nuts.put(turn.joint, replace(turn.nut, hex_deg=self._socket_deg(gun, now)))

    # ------------------------------------------------------------ programs

    def begin(
        self, gun: GunName, key: str, program: TighteningProgram, now: float, *, feigned: bool = False
    ) -> ActiveRun:
        """Start `program`; it ends by itself at `end_s` or by `stop`, whoever waits for it."""
        self.advance(now)
        memory = self.guns[gun]
        memory.keys.add(key)
        joint, free, curve = self._before_socket(gun, program, now, feigned)
        rng = self.nuts.rng("trace", -1 if joint is None else joint, memory.tightening_id)
        run = drive(curve, program, self.gun, rng, target=program.direction == "tighten")
        memory.active = ActiveRun(key, program, run, joint, free, now, feigned)
        return memory.active

    def _before_socket(
        self, gun: GunName, program: TighteningProgram, now: float, feigned: bool
    ) -> tuple[int | None, float, Curve]:
        """(joint, free angle, curve over the nut's rotation plus the free angle) for a program that starts now."""
        nothing = (None, 0.0, free_spin(self.properties))
        joint = self.joint_at(gun, now)
        if feigned or joint is None or self._force_now_n(gun, now) < gun_bench.CONTACT_N:
            return nothing
        sense = 1.0 if program.direction == "tighten" else -1.0
        if self.guns[gun].nut_in_socket:
            start = self._start_thread(gun, joint, 720.0 * sense, 1e3, self._force_now_n(gun, now))
            if start.takes_nut is None or start.nut is None:
                return nothing
            self.apply(gun, start, now)
        nut = self.nuts.struck(joint)
        if not nut.present:
            return nothing
        free = self._free_deg(gun, nut, now, sense)
        curve = (tightening if sense > 0 else loosening)(self.properties, nut, self.nuts.condition(joint))
        if "slip_off" in self.nuts.planted.get(joint, ()):
            self.nuts.planted[joint].discard("slip_off")
            curve = slipping(curve, 0.6 * program.target_torque_nm)
        return joint, free, replace(curve, rotation_deg=curve.rotation_deg + free)

    def stop(self, gun: GunName, now: float) -> None:
        """Halt a running program where it is; it leaves no result."""
        self.advance(now)
        memory = self.guns[gun]
        if memory.active is not None:
            self._settle(memory, memory.active, now)
            memory.active = None

    def advance(self, now: float) -> None:
        """Let everything that has ended by `now` become true, in the order in which it ended."""
        self._follow_parts()
        ended = [m for m in self.guns.values() if m.active is not None and m.active.end_s <= now]
        for memory in sorted(ended, key=lambda m: m.active.end_s if m.active else 0.0):
            if (active := memory.active) is not None:
                if active.joint is not None:
                    self.nuts.react(self._reaction_nm(active))
                self._settle(memory, active, active.end_s)
                self._store(memory, active)
        for memory in ended:
            memory.active = None
        self.nuts.follow_temperature()

    def _settle(self, memory: GunMemory, active: ActiveRun, now: float) -> None:
        """What the run has done by `now` to spindle and nut."""
        sense = 1.0 if active.program.direction == "tighten" else -1.0
        spindle, rotation, preload = active.run.at(now - active.start_s)
        if active.joint is None:
            memory.spindle_deg += sense * spindle
            return
        on_nut = max(rotation - active.free_deg, 0.0)
        # The wind-up springs back when the torque goes.
        memory.spindle_deg += sense * rotation
        nut = self.nuts.state[active.joint]
        moved = self.nuts.moved(nut, sense * on_nut, preload if on_nut > 0.0 else nut.preload_n)
        if moved is None:
            memory.nut_in_socket = True
            self.nuts.put(active.joint, NutState())
        else:
            at = self._socket_deg(memory.name, now)
            self.nuts.put(active.joint, replace(moved, hex_deg=at, passes=nut.passes + 1))

    def _reaction_nm(self, active: ActiveRun) -> float:
        """Peak torque of this run and of the other gun's while it runs, about +z."""
        sense = 1.0 if active.program.direction == "tighten" else -1.0
        running = [m.active for m in self.guns.values() if m.active is not None]
        return sense * self.properties.hand * sum(run.run.peak_torque_nm for run in running)

    def _store(self, memory: GunMemory, active: ActiveRun) -> None:
        memory.tightening_id += 1
        program, trace = active.program, active.run.trace
        seen = evaluate(trace, program)
        target = program.target_torque_nm
        result = TighteningResult(
            key=active.key,
            controller_serial=memory.serial,
            tightening_id=memory.tightening_id,
            ok=active.feigned or seen.ok,
            torque_nm=target if active.feigned else seen.torque_nm,
            angle_deg=max(program.angle_low_deg, 0.0) if active.feigned else seen.angle_deg,
            torque_band=Band.OK if active.feigned else seen.torque_band,
            angle_band=Band.OK if active.feigned else seen.angle_band,
            trace=trace,
            time_s=active.end_s,
        )
        memory.results[active.key] = memory.last = result
