"""From what is asked to an acceleration: a jerk-limited reference, and the loop that tracks it.

Both work in the autopilot's local frame (north, east, down; m, m/s, m/s^2).

``Shaper`` moves a desired state towards a target with bounded speed of correction, acceleration and jerk, as ArduPilot
does for everything and PX4 for its automatic modes. ``Tracker`` holds the vehicle to a desired state: proportional on
position, proportional and integral on velocity, velocity and acceleration fed forward.
"""

from __future__ import annotations

import math


def square_root_control(error: float, gain: float, limit: float) -> float:
    """Rate that closes an error (>= 0) at ``gain`` near zero and no faster than ``limit`` can brake farther out."""
    if limit <= 0.0:
        return error * gain
    linear = limit / (gain * gain)
    if error <= linear:
        return error * gain
    return math.sqrt(2.0 * limit * (error - 0.5 * linear))


class Shaper:
    """A desired state that follows a target within limits. Attributes are the state: ``p*``, ``v*``, ``a*``."""

    def __init__(self) -> None:
        self.pn = self.pe = self.pd = 0.0
        self.vn = self.ve = self.vd = 0.0
        self.an = self.ae = self.ad = 0.0

    def reset(self, position: tuple[float, float, float], velocity: tuple[float, float, float]) -> None:
        """Starts from a state of motion, without acceleration."""
        self.pn, self.pe, self.pd = position
        self.vn, self.ve, self.vd = velocity
        self.an = self.ae = self.ad = 0.0

    def horizontal(
        self,
        target: tuple[float, float, float, float, float, float],
        *,
        use_position: bool,
        max_correction_m_s: float,
        accel_m_s2: float,
        jerk_m_s3: float,
        brake_m_s2: float,
        dt: float,
    ) -> None:
        """One step towards ``(pn, pe, vn, ve, an, ae)``; ``brake_m_s2`` decides how late it slows down."""
        tpn, tpe, tvn, tve, tan, tae = target
        gain = jerk_m_s3 / accel_m_s2
        if use_position:
            en, ee = tpn - self.pn, tpe - self.pe
            error = math.sqrt(en * en + ee * ee)
            if error > 1e-9:
                rate = min(square_root_control(error, 0.5 * gain, brake_m_s2), max_correction_m_s) / error
                tvn += en * rate
                tve += ee * rate
        en, ee = tvn - self.vn, tve - self.ve
        error = math.sqrt(en * en + ee * ee)
        if error > 1e-9:
            rate = min(square_root_control(error, gain, jerk_m_s3), accel_m_s2) / error
            tan += en * rate
            tae += ee * rate
        dn, de = tan - self.an, tae - self.ae
        change = math.sqrt(dn * dn + de * de)
        most = jerk_m_s3 * dt
        if change > most:
            dn *= most / change
            de *= most / change
        self.an += dn
        self.ae += de
        half = 0.5 * dt * dt
        self.pn += self.vn * dt + self.an * half
        self.pe += self.ve * dt + self.ae * half
        self.vn += self.an * dt
        self.ve += self.ae * dt

    def vertical(
        self,
        target: tuple[float, float, float],
        *,
        use_position: bool,
        up_m_s: float,
        down_m_s: float,
        accel_m_s2: float,
        jerk_m_s3: float,
        brake_m_s2: float,
        dt: float,
    ) -> None:
        """One step towards ``(pd, vd, ad)``; speeds limit the correction, ``brake_m_s2`` how late it slows down."""
        tpd, tvd, tad = target
        gain = jerk_m_s3 / accel_m_s2
        if use_position:
            error = tpd - self.pd
            rate = square_root_control(abs(error), min(0.5 * gain, 1.0), brake_m_s2)
            tvd += min(rate, down_m_s) if error > 0.0 else -min(rate, up_m_s)
        error = tvd - self.vd
        rate = min(square_root_control(abs(error), gain, jerk_m_s3), accel_m_s2)
        tad += rate if error > 0.0 else -rate
        most = jerk_m_s3 * dt
        self.ad += max(-most, min(most, tad - self.ad))
        self.pd += self.vd * dt + 0.5 * self.ad * dt * dt
        self.vd += self.ad * dt


class Tracker:
    """Position and velocity loops.

    Args:
        position_gain: horizontal and vertical, 1/s.
        velocity_gain: horizontal and vertical, 1/s.
        integral_gain: horizontal and vertical, 1/s^2.
        integral_limit_m_s2: most the integral may add.
    """

    def __init__(
        self,
        position_gain: tuple[float, float],
        velocity_gain: tuple[float, float],
        integral_gain: tuple[float, float],
        integral_limit_m_s2: float = 5.0,
    ) -> None:
        self.position_gain = position_gain
        self.velocity_gain = velocity_gain
        self.integral_gain = integral_gain
        self.integral_limit_m_s2 = integral_limit_m_s2
        self.in_ = self.ie = self.id = 0.0

    def reset(self) -> None:
        """Forgets the integral."""
        self.in_ = self.ie = self.id = 0.0

    def horizontal(
        self, velocity: tuple[float, float], feed: tuple[float, float], now: tuple[float, float], dt: float
    ) -> tuple[float, float]:
        """Acceleration (north, east) for a velocity wanted, an acceleration fed forward and the velocity now."""
        gain, most = self.velocity_gain[0], self.integral_limit_m_s2
        rate = self.integral_gain[0] * dt
        en, ee = velocity[0] - now[0], velocity[1] - now[1]
        sum_n, sum_e = self.in_ + en * rate, self.ie + ee * rate
        self.in_ = sum_n if -most < sum_n < most else math.copysign(most, sum_n)
        self.ie = sum_e if -most < sum_e < most else math.copysign(most, sum_e)
        return feed[0] + gain * en + self.in_, feed[1] + gain * ee + self.ie

    def vertical(self, velocity: float, feed: float, now: float, dt: float) -> float:
        """Acceleration down for a velocity wanted, an acceleration fed forward and the velocity now."""
        most = self.integral_limit_m_s2
        error = velocity - now
        total = self.id + error * self.integral_gain[1] * dt
        self.id = total if -most < total < most else math.copysign(most, total)
        return feed + self.velocity_gain[1] * error + self.id


def constrain_sum(first: tuple[float, float], second: tuple[float, float], most: float) -> tuple[float, float]:
    """``first + second`` no longer than ``most``, the second cut back before the first (PX4's rule for velocity)."""
    total = (first[0] + second[0], first[1] + second[1])
    if total[0] * total[0] + total[1] * total[1] <= most * most:
        return total
    length = math.hypot(*first)
    if length >= most:
        return first[0] * most / length, first[1] * most / length
    other = math.hypot(*second)
    un, ue = second[0] / other, second[1] / other
    along = un * first[0] + ue * first[1]
    reach = -along + math.sqrt(along * along - (length * length - most * most))
    return first[0] + un * reach, first[1] + ue * reach
