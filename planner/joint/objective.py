"""What the joint problem minimises: the mission time, and a little besides.

    sum T  +  energy_weight * energy  +  evenness / 2 * sum over joints (T_k+1 / pace_k+1 - T_k / pace_k)^2

*Evenness.* A curve cut into pieces may be cut anywhere: where no limit binds, moving a joint along the curve changes
nothing, and a Newton method wanders along such directions for dozens of steps. The last term holds neighbouring
durations in the proportions of the first guess (``pace``), and at the last barrier's parameter of what was found by
then, so that it costs next to nothing. Its weight falls with the barrier's parameter, down to a floor.

*Energy.* The integral of |a|^2 / a_max^2 + |v|^3 / v_max^3: what manoeuvring and drag add to the power a vehicle needs
to stay aloft, which sum T stands for. Gauss quadrature with four nodes a piece, exact for the first term.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from planner.arrays import Array
from planner.joint.control_rows import GAUSS_WEIGHTS, Table
from planner.joint.transcription import FIRST_AXIS, SECOND_AXIS, Point


@dataclass(frozen=True, eq=False)
class Objective:
    """``pace`` ``(K,)``; ``speed`` and ``accel`` are the limits, scaled like the program. The table needs its nodes
    where ``energy_weight`` is not zero.
    """

    table: Table
    pace: Array
    evenness: float = 0.0
    energy_weight: float = 0.0
    speed: float = 1.0
    accel: float = 1.0

    def value(self, at: Point) -> float:
        """The objective."""
        uneven = self._uneven(at)
        total = float(at.durations.sum()) + 0.5 * self.evenness * float(uneven @ uneven)
        if self.energy_weight:
            velocity, acceleration = self._densities(at)
            total += float(at.durations @ (velocity + acceleration).sum(0))
        return total

    def durations_gradient(self, at: Point) -> Array:
        """Gradient by T ``(K,)``, rows held."""
        uneven = self._uneven(at)
        gradient = np.ones(len(self.pace))
        gradient[1:] += self._weight[1:] * uneven
        gradient[:-1] -= self._weight[:-1] * uneven
        if self.energy_weight:
            velocity, acceleration = self._densities(at)
            gradient += (velocity + acceleration).sum(0)
        return gradient

    @cached_property
    def evenness_hessian(self) -> tuple[Array, Array]:
        """The evenness term's Hessian, constant: its diagonal ``(K,)`` and, for neighbours, ``(K - 1,)``."""
        diagonal = self._weight * self._inverse_pace
        diagonal[1:-1] *= 2.0
        neighbours = -self._weight[1:] * self._inverse_pace[:-1]
        return (diagonal if len(diagonal) > 1 else np.zeros(1)), neighbours

    @cached_property
    def _inverse_pace(self) -> Array:
        return 1.0 / self.pace

    @cached_property
    def _weight(self) -> Array:
        return self.evenness * self._inverse_pace

    def _uneven(self, at: Point) -> Array:
        even = at.durations * self._inverse_pace
        return np.asarray(even[1:] - even[:-1])

    def row_gradient(self, at: Point) -> Array:
        """Gradient by the control-point rows at the nodes, velocities first, divided by T: ``(8, 3, K)``."""
        velocity, acceleration = self._nodes(at)
        weight = self.energy_weight * GAUSS_WEIGHTS[:, None, None]
        fast = np.sqrt((velocity * velocity).sum(1, keepdims=True))
        return np.concatenate(
            [weight * 3.0 * fast * velocity / self.speed**3, weight * 2.0 * acceleration / self.accel**2]
        )

    def row_hessian(self, at: Point) -> Array:
        """Hessian by the rows at the nodes, divided by T: ``(8, 6, K)``."""
        velocity, acceleration = self._nodes(at)
        weight = self.energy_weight * GAUSS_WEIGHTS[:, None, None]
        fast = np.sqrt((velocity * velocity).sum(1, keepdims=True))
        diagonal = (FIRST_AXIS == SECOND_AXIS)[:, None]
        outer = velocity[:, FIRST_AXIS] * velocity[:, SECOND_AXIS] / np.maximum(fast, 1e-12)
        second = np.broadcast_to(2.0 * diagonal / self.accel**2, (len(acceleration), 6, velocity.shape[-1]))
        return np.concatenate([weight * 3.0 * (fast * diagonal + outer) / self.speed**3, weight * second])

    def _nodes(self, at: Point) -> tuple[Array, Array]:
        return at.rows[list(self.table.velocity_rows)], at.rows[list(self.table.acceleration_rows)]

    def _densities(self, at: Point) -> tuple[Array, Array]:
        """Weighted energy per unit of time at the nodes, ``(4, K)`` each."""
        velocity, acceleration = self._nodes(at)
        weight = self.energy_weight * GAUSS_WEIGHTS[:, None]
        return (
            weight * (velocity * velocity).sum(1) ** 1.5 / self.speed**3,
            weight * (acceleration * acceleration).sum(1) / self.accel**2,
        )
