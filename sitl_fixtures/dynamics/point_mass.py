"""The aircraft as a point mass over the WGS84 ellipsoid.

State: geodetic latitude and longitude (rad), height above the ellipsoid (m), velocity along true north, east and down
(m/s), and the acceleration its rotors give (m/s^2, gravity already balanced). A commanded acceleration is bounded by
the lean angle and by the thrust available, its change by a jerk limit, and it is reached through a first-order lag
that stands for the attitude loop. Drag is linear plus quadratic in the speed through the air. Top speed is not a
setting: it is where the lean and the drag balance.

    g tan(lean) = c1 v + c2 v^2

Altitude above mean sea level is taken as ellipsoidal height. The ground is level at the altitude of the take-off place.
"""

from __future__ import annotations

import math

GRAVITY_M_S2 = 9.80665
WGS84_A_M = 6378137.0
WGS84_E2 = 6.69437999014e-3


def radii_m(lat_rad: float) -> tuple[float, float]:
    """Radii of curvature (meridian, prime vertical) of WGS84 at a latitude, m."""
    sin_lat = math.sin(lat_rad)
    w2 = 1.0 - WGS84_E2 * sin_lat * sin_lat
    prime_vertical = WGS84_A_M / math.sqrt(w2)
    return prime_vertical * (1.0 - WGS84_E2) / w2, prime_vertical


class PointMass:
    """The aircraft's true motion. All attributes may be read; ``step`` moves it on.

    Args:
        lat_deg, lon_deg: where it stands, degrees.
        height_m: height of the ground there (AMSL taken as ellipsoidal), m.
        tilt_rad: largest lean, rad.
        lag_s: time constant of the attitude loop, s.
        jerk_m_s3: largest change of the thrust acceleration, m/s^3.
        drag_linear_1_s, drag_quadratic_1_m: drag per mass, ``c1 v + c2 v^2``.
    """

    def __init__(
        self,
        lat_deg: float,
        lon_deg: float,
        height_m: float,
        *,
        tilt_rad: float = math.radians(45.0),
        lag_s: float = 0.2,
        jerk_m_s3: float = 60.0,
        drag_linear_1_s: float = 0.01,
        drag_quadratic_1_m: float = 0.001,
    ) -> None:
        self.lat_rad = math.radians(lat_deg)
        self.lon_rad = math.radians(lon_deg)
        self.height_m = height_m
        self.ground_m = height_m
        self.vn = self.ve = self.vd = 0.0
        self.an = self.ae = self.ad = 0.0
        self.drag_n = self.drag_e = self.drag_d = 0.0
        self.wind_n_m_s = self.wind_e_m_s = 0.0
        self.tilt_rad = tilt_rad
        self.lag_s = lag_s
        self.jerk_m_s3 = jerk_m_s3
        self.drag_linear_1_s = drag_linear_1_s
        self.drag_quadratic_1_m = drag_quadratic_1_m
        self.max_up_m_s2 = 9.0
        self.max_down_m_s2 = 7.0
        self.thrust_factor = 1.0
        self.on_ground = True
        self.impact_m_s = 0.0
        self._decay_for: tuple[float, float] = (0.0, 0.0)
        self._decay = 1.0

    @property
    def lat_deg(self) -> float:
        """Geodetic latitude, degrees."""
        return math.degrees(self.lat_rad)

    @property
    def lon_deg(self) -> float:
        """Longitude, degrees, -180 to 180."""
        return math.degrees(self.lon_rad)

    @property
    def above_ground_m(self) -> float:
        """Height above the ground, m."""
        return self.height_m - self.ground_m

    @property
    def speed_m_s(self) -> float:
        """Speed over the ground, m/s."""
        return math.hypot(self.vn, self.ve)

    def cap_speed(self, top_speed_m_s: float) -> None:
        """Sets the drag, quadratic alone, so that level flight at the largest lean tops out at a speed."""
        self.drag_linear_1_s = 0.0
        self.drag_quadratic_1_m = GRAVITY_M_S2 * math.tan(self.tilt_rad) / top_speed_m_s**2

    def step(self, cmd_n: float, cmd_e: float, cmd_d: float, dt: float, rotors: bool) -> None:
        """Moves on by ``dt`` seconds with a commanded acceleration (north, east, down, m/s^2).

        ``rotors`` false means no thrust: the aircraft falls, or stands.
        """
        if rotors:
            cmd_n, cmd_e, cmd_d = self._within_limits(cmd_n, cmd_e, cmd_d)
        else:
            cmd_n, cmd_e, cmd_d = 0.0, 0.0, GRAVITY_M_S2
        self._turn_thrust(cmd_n, cmd_e, cmd_d, dt)
        if self.on_ground:
            if not rotors or self.ad > -0.2:
                self.vn = self.ve = self.vd = 0.0
                self.an = self.ae = 0.0
                # Thrust that builds up stays; the ground takes what presses down.
                self.ad = min(self.ad, 0.0)
                return
            self.on_ground = False
        self._move(dt)

    def _within_limits(self, cmd_n: float, cmd_e: float, cmd_d: float) -> tuple[float, float, float]:
        """A commanded acceleration as far as lean and thrust allow it."""
        limit = GRAVITY_M_S2 * math.tan(self.tilt_rad) * self.thrust_factor
        horizontal = math.sqrt(cmd_n * cmd_n + cmd_e * cmd_e)
        if horizontal > limit:
            scale = limit / horizontal
            cmd_n *= scale
            cmd_e *= scale
        up = self.max_up_m_s2 * self.thrust_factor
        if cmd_d < -up:
            cmd_d = -up
        elif cmd_d > self.max_down_m_s2:
            cmd_d = self.max_down_m_s2
        return cmd_n, cmd_e, cmd_d

    def _turn_thrust(self, cmd_n: float, cmd_e: float, cmd_d: float, dt: float) -> None:
        """The thrust acceleration follows the command through the attitude loop's lag, its change jerk-limited."""
        if self._decay_for != (dt, self.lag_s):
            self._decay_for = (dt, self.lag_s)
            self._decay = 1.0 - math.exp(-dt / self.lag_s)
        decay = self._decay
        dn = (cmd_n - self.an) * decay
        de = (cmd_e - self.ae) * decay
        dd = (cmd_d - self.ad) * decay
        change = math.sqrt(dn * dn + de * de)
        most = self.jerk_m_s3 * dt
        if change > most:
            scale = most / change
            dn *= scale
            de *= scale
        if dd > most:
            dd = most
        elif dd < -most:
            dd = -most
        self.an += dn
        self.ae += de
        self.ad += dd

    def _move(self, dt: float) -> None:
        """Velocity and place in the air, and the touch-down."""
        vn, ve, vd = self.vn, self.ve, self.vd
        wn, we = vn - self.wind_n_m_s, ve - self.wind_e_m_s
        drag = self.drag_linear_1_s + self.drag_quadratic_1_m * math.sqrt(wn * wn + we * we + vd * vd)
        self.drag_n, self.drag_e, self.drag_d = -drag * wn, -drag * we, -drag * vd
        new_n = vn + (self.an + self.drag_n) * dt
        new_e = ve + (self.ae + self.drag_e) * dt
        new_d = vd + (self.ad + self.drag_d) * dt
        half = 0.5 * dt
        sin_lat = math.sin(self.lat_rad)
        cos_lat = math.sqrt(1.0 - sin_lat * sin_lat)
        meridian, prime_vertical = radii_m(self.lat_rad)
        self.lat_rad += (vn + new_n) * half / (meridian + self.height_m)
        self.lon_rad += (ve + new_e) * half / ((prime_vertical + self.height_m) * cos_lat)
        if self.lon_rad > math.pi:
            self.lon_rad -= 2.0 * math.pi
        elif self.lon_rad < -math.pi:
            self.lon_rad += 2.0 * math.pi
        self.height_m -= (vd + new_d) * half
        self.vn, self.ve, self.vd = new_n, new_e, new_d
        if self.height_m <= self.ground_m and new_d >= 0.0:
            self.height_m = self.ground_m
            self.impact_m_s = new_d
            self.on_ground = True
            self.vn = self.ve = self.vd = 0.0
            self.an = self.ae = self.ad = 0.0

    def attitude_rad(self, yaw_rad: float) -> tuple[float, float]:
        """Roll and pitch (rad) that give the present thrust acceleration at a heading."""
        forward = self.an * math.cos(yaw_rad) + self.ae * math.sin(yaw_rad)
        right = -self.an * math.sin(yaw_rad) + self.ae * math.cos(yaw_rad)
        lift = GRAVITY_M_S2 - self.ad
        return math.atan2(right, lift), -math.atan2(forward, lift)
