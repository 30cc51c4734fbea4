"""A battery: charge drawn by hovering, by speed and by climbing; voltage by charge and load.

Simple, but it adds up: the charge used is the integral of the current reported, and the share remaining is what is
left of the capacity.
"""

from __future__ import annotations


class Battery:
    """State of the one battery.

    Args:
        capacity_mah: charge when full.
        hover_a: current in hover.
    """

    def __init__(self, capacity_mah: float = 100000.0, hover_a: float = 25.0) -> None:
        self.capacity_mah = capacity_mah
        self.hover_a = hover_a
        self.used_mah = 0.0
        self.current_a = 0.0
        self.drain_factor = 1.0

    @property
    def remaining(self) -> float:
        """Share of the capacity left, 0 to 1."""
        return max(0.0, 1.0 - self.used_mah / self.capacity_mah)

    @property
    def voltage_v(self) -> float:
        """Voltage of three cells under load, V: 4.2 V a cell full, 3.3 V empty, less the internal drop."""
        left = self.remaining
        cell = 3.3 + 0.9 * left if left > 0.0 else 3.0
        return 3.0 * cell - 0.004 * self.current_a

    def step(self, dt: float, running: bool, thrust_accel_m_s2: float, speed_m_s: float) -> None:
        """Draws charge: momentum theory's 3/2 power of thrust, and a little for speed."""
        if running:
            load = (thrust_accel_m_s2 / 9.80665) ** 1.5 if thrust_accel_m_s2 > 0.0 else 0.0
            self.current_a = self.drain_factor * self.hover_a * (0.1 + 0.9 * load + 0.0002 * speed_m_s * speed_m_s)
        else:
            self.current_a = 0.5 * self.drain_factor
        self.used_mah = min(self.capacity_mah, self.used_mah + self.current_a * dt / 3.6)
