"""The joint problem's functions: rows against Bézier curves, derivatives against finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.linalg import lapack

from planner import bezier
from planner.joint.control_rows import GAUSS_NODES, GAUSS_WEIGHTS, J_ROWS, K_ROWS, P_ROWS, Q_ROWS, table
from planner.joint.newton import NewtonSystem
from planner.joint.objective import Objective
from planner.joint.transcription import HeightConstraints, NormConstraints, Transcription

Array = NDArray[np.float64]


def random_program(rng: np.random.Generator, pieces: int, *, jerk: bool, energy: bool) -> Transcription:
    """Every family of constraints with random data: balls, two to a piece at times, cones, jerk, wind, heights."""
    rows: list[NDArray[np.int64]] = []
    where: list[NDArray[np.int64]] = []
    families: list[tuple[Array, Array, Array, Array, Array]] = []

    def add(
        row: int, *, weight: Array | None = None, radius: float = 1.0, time: float = 0.0, part: float = 1.0
    ) -> None:
        chosen = np.flatnonzero(rng.uniform(size=pieces) <= part)
        count = len(chosen)
        rows.append(np.full(count, row))
        where.append(chosen)
        families.append(
            (
                rng.normal(size=(3, count)),
                np.broadcast_to(np.ones(3) if weight is None else weight, (count, 3)).T,
                np.full(count, radius),
                np.full(count, time),
                rng.uniform(0.5, 2.0, count),
            )
        )

    for row in P_ROWS:
        add(row)
        add(row, part=0.5)
        add(row, weight=np.array([0.3, 0.3, -1.0]), radius=0.0, part=0.7)
    for row in (*Q_ROWS, *K_ROWS):
        add(row)
    if jerk:
        for row in J_ROWS:
            add(row, weight=np.full(3, 9.0), radius=0.0, time=0.8)
    norms = NormConstraints(
        np.concatenate(rows),
        np.concatenate(where),
        *(np.concatenate(part, axis=-1) for part in zip(*families, strict=True)),
    )
    high_rows = np.repeat(np.array([*P_ROWS[1:], *Q_ROWS]), pieces)
    count = len(high_rows)
    heights = HeightConstraints(
        high_rows,
        np.tile(np.arange(pieces), count // pieces),
        np.full(count, -1.0),
        np.full(count, 1.5),
        rng.uniform(0.5, 2.0, count),
    )
    return Transcription(
        table(jerk=jerk, nodes=energy),
        rng.normal(size=9),
        rng.normal(size=9),
        norms,
        heights,
        rng.uniform(0.1, 0.2, pieces),
    )


class Scene:
    """A random program at a random point, its unknowns as one vector."""

    def __init__(self, seed: int, pieces: int, *, jerk: bool, energy: bool) -> None:
        rng = np.random.default_rng(seed)
        self.program = random_program(rng, pieces, jerk=jerk, energy=energy)
        self.objective = Objective(
            self.program.table,
            rng.uniform(0.5, 2.0, pieces),
            evenness=0.3,
            energy_weight=0.7 if energy else 0.0,
            speed=1.2,
            accel=0.9,
        )
        x = rng.normal(size=self.program.unknowns)
        x[0::10] = rng.uniform(0.5, 2.0, pieces)
        self.at = np.concatenate([x, rng.normal(size=6 * pieces)])
        self.multipliers = rng.uniform(0.1, 2.0, self.program.constraints)
        self.equation = rng.normal(size=(2, 3, pieces))
        self.rng = rng

    def split(self, z: Array) -> tuple[Array, Array]:
        n = self.program.unknowns
        return z[:n], z[n:].reshape(2, 3, -1)

    def inequalities(self, z: Array) -> Array:
        return self.program.evaluate(*self.split(z)).inequalities

    def equations(self, z: Array) -> Array:
        return self.program.evaluate(*self.split(z)).equations.ravel()

    def lagrangian(self, z: Array) -> float:
        point = self.program.evaluate(*self.split(z))
        return float(
            self.objective.value(point)
            + self.multipliers @ point.inequalities
            + (self.equation * point.equations).sum()
        )

    def gradient(self, z: Array) -> Array:
        point = self.program.evaluate(*self.split(z))
        system = NewtonSystem(self.program, self.objective, point, self.multipliers, self.equation)
        return np.concatenate([system.gradient, system.inner_gradient.ravel()])

    def jacobian(self, function: object, z: Array, step: float = 1e-6) -> Array:
        columns = []
        for k in range(len(z)):
            e = np.zeros_like(z)
            e[k] = step
            columns.append((np.asarray(function(z + e)) - np.asarray(function(z - e))) / (2 * step))  # type: ignore[operator]
        return np.stack(columns, axis=-1)


CASES = [(1, False, False), (3, False, False), (3, True, False), (2, False, True), (3, True, True)]


@pytest.mark.parametrize(("jerk", "energy"), [(False, False), (True, True)])
def test_rows_are_control_points_of_the_curve(jerk: bool, energy: bool) -> None:
    """P from the rows; Q, K and the jerk by differences of P (paper equations (9), (11)) equal their rows."""
    scene = Scene(1, 4, jerk=jerk, energy=energy)
    x, _ = scene.split(scene.at)
    inner = scene.program.consistent_inner(x)
    point = scene.program.evaluate(x, inner)
    rows = point.rows.transpose(2, 0, 1)
    t = point.durations[:, None, None]
    points = rows[:, list(P_ROWS)]
    velocity = bezier.derivative(points) / t
    accel = bezier.derivative(points, 2) / t**2
    assert rows[:, list(Q_ROWS)] == pytest.approx(velocity[:, 1:], abs=1e-9)
    assert rows[:, list(K_ROWS)] == pytest.approx(accel[:, 1:], abs=1e-9)
    assert point.equations == pytest.approx(np.zeros((2, 3, 4)), abs=1e-12)
    # Neighbours meet in position, velocity and acceleration.
    assert points[1:, 0] == pytest.approx(points[:-1, -1])
    assert velocity[1:, 0] == pytest.approx(velocity[:-1, -1])
    assert accel[1:, 0] == pytest.approx(accel[:-1, -1])
    named = scene.program.table
    if jerk:
        third = bezier.derivative(points, 3) / t**3
        assert 3.0 * rows[:, list(named.jerk_rows)] / t == pytest.approx(third, abs=1e-8)
    if energy:
        for rows_at, curve in ((named.velocity_rows, velocity), (named.acceleration_rows, accel)):
            for row, u in zip(rows_at, GAUSS_NODES, strict=True):
                assert rows[:, row] == pytest.approx(bezier.evaluate(curve, np.full(4, u)), abs=1e-9)


def test_energy_is_the_integral() -> None:
    """Against a fine trapezoidal sum of |a|^2 / a_max^2 + |v|^3 / v_max^3 over one piece (the first term is exact)."""
    scene = Scene(2, 1, jerk=False, energy=True)
    x, _ = scene.split(scene.at)
    point = scene.program.evaluate(x, scene.program.consistent_inner(x))
    points = point.rows[:6, :, 0]
    u = np.linspace(0, 1, 20001)
    t = float(point.durations[0])
    speed = np.linalg.norm(bezier.evaluate(bezier.derivative(points) / t, u), axis=1)
    accel = np.linalg.norm(bezier.evaluate(bezier.derivative(points, 2) / t**2, u), axis=1)
    assert GAUSS_WEIGHTS.sum() == pytest.approx(1.0)
    energy = t * np.trapezoid(accel**2 / 0.9**2 + speed**3 / 1.2**3, u)
    assert scene.objective.value(point) == pytest.approx(t + 0.7 * energy, rel=2e-2)
    still = Objective(scene.program.table, scene.objective.pace, energy_weight=0.7, speed=1e6, accel=0.9)
    assert still.value(point) == pytest.approx(t + 0.7 * t * np.trapezoid(accel**2, u) / 0.81, rel=1e-6)


@pytest.mark.parametrize(("pieces", "jerk", "energy"), CASES)
def test_first_derivatives(pieces: int, jerk: bool, energy: bool) -> None:
    """Products with the Jacobian, and the Lagrangian's gradient, against central differences."""
    scene = Scene(pieces, pieces, jerk=jerk, energy=energy)
    step = scene.rng.normal(size=len(scene.at))
    point = scene.program.evaluate(*scene.split(scene.at))
    durations, vectors = scene.program.vectors(*scene.split(step), step=True)
    rows = scene.program.row_step(point, durations, vectors)
    expected = scene.jacobian(scene.inequalities, scene.at) @ step
    assert scene.program.change(point, durations, rows) == pytest.approx(expected, rel=1e-6, abs=1e-7)
    expected = scene.jacobian(scene.equations, scene.at) @ step
    assert rows[-2:].ravel() == pytest.approx(expected, rel=1e-6, abs=1e-7)
    expected = scene.jacobian(scene.lagrangian, scene.at)
    assert scene.gradient(scene.at) == pytest.approx(expected, rel=1e-6, abs=1e-6)


@pytest.mark.parametrize(("pieces", "jerk", "energy"), CASES)
def test_newton_step_solves_the_whole_system(pieces: int, jerk: bool, energy: bool) -> None:
    """The condensed step satisfies the full, dense KKT equations, with a Hessian from differences of the gradient."""
    scene = Scene(10 + pieces, pieces, jerk=jerk, energy=energy)
    program, rng = scene.program, scene.rng
    point = program.evaluate(*scene.split(scene.at))
    system = NewtonSystem(program, scene.objective, point, scene.multipliers, scene.equation)
    ratio = rng.uniform(0.1, 3.0, program.constraints)
    gap, centring = rng.normal(size=program.constraints), rng.uniform(0.1, 1.0, program.constraints)
    band = system.condense(ratio)
    hessian = scene.jacobian(scene.gradient, scene.at)
    inequality = scene.jacobian(scene.inequalities, scene.at)
    equation = scene.jacobian(scene.equations, scene.at)
    # The matrix on the null space of the equations, in which K_1 and K_2 move along with the joints.
    joints = program.unknowns
    null = np.concatenate([np.eye(joints), -np.linalg.solve(equation[:, joints:], equation[:, :joints])])
    reduced = null.T @ (hessian + inequality.T @ (ratio[:, None] * inequality)) @ null
    for offset in range(19):
        width = joints - offset
        assert band[offset, : max(width, 0)] == pytest.approx(np.diagonal(reduced, -offset), rel=1e-6, abs=1e-5)
    # Cholesky needs it positive definite: a shift on the joint unknowns.
    shift = max(0.0, 0.1 - float(np.linalg.eigvalsh(reduced).min()))
    band[0] += shift
    factor, info = lapack.dpbtrf(band, lower=1)
    assert info == 0
    step = system.direction(factor, ratio, gap, point.equations, centring)
    moved = np.concatenate([step.x, step.inner.ravel()])
    assert hessian == pytest.approx(hessian.T, abs=1e-5)
    change = inequality @ moved
    new = scene.multipliers + step.multiplier
    assert step.slack == pytest.approx(-gap - change, rel=1e-5, abs=1e-6)
    assert new == pytest.approx(centring + ratio * (gap + change), rel=1e-5, abs=1e-5)
    assert equation @ moved == pytest.approx(-point.equations.ravel(), rel=1e-5, abs=1e-6)
    objective = scene.jacobian(lambda z: scene.objective.value(program.evaluate(*scene.split(z))), scene.at)
    residual = hessian @ moved + objective + inequality.T @ new + equation.T @ step.equation.ravel()
    residual[: program.unknowns] += shift * step.x
    assert residual == pytest.approx(np.zeros_like(residual), abs=1e-6 * float((np.abs(hessian) @ np.abs(moved)).max()))
    assert system.slope(step) == pytest.approx(float(objective @ moved), rel=1e-5)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_consistent_inner_leaves_no_residual(seed: int, pieces: int) -> None:
    scene = Scene(seed, pieces, jerk=False, energy=False)
    x, _ = scene.split(scene.at)
    point = scene.program.evaluate(x, scene.program.consistent_inner(x))
    assert np.abs(point.equations).max() < 1e-9
    limited = scene.program.consistent_inner(x, 0.5)
    assert np.linalg.norm(limited, axis=1).max() <= 0.5 * (1 + 1e-12)


def test_what_cannot_move_is_left_out() -> None:
    """From rest to rest in one piece, P_0 .. P_5, K_3 and Q_4 are fixed: only Q_1 .. Q_3 and K_1, K_2 depend on
    anything (here Q_1 and Q_3 do not either: they are zero at a rest).
    """
    rows = np.array([*P_ROWS, *Q_ROWS, *K_ROWS])
    count = len(rows)
    norms = NormConstraints(
        rows, np.zeros(count, int), np.zeros((3, count)), np.ones((3, count)), *(np.ones(count) for _ in range(3))
    )
    heights = HeightConstraints(*(np.zeros(0, int) for _ in range(2)), *(np.zeros(0) for _ in range(3)))
    rest = np.zeros(9)
    program = Transcription(table(), rest, np.concatenate([np.ones(3), np.zeros(6)]), norms, heights, np.ones(1))
    assert program.norms.rows.tolist() == [7, 10, 11]
    moving = np.concatenate([np.zeros(3), np.ones(3), np.zeros(3)])
    program = Transcription(table(), moving, rest, norms, heights, np.ones(1))
    # Now P_1, P_2 move with T; P_0 and Q_1 = V stay.
    assert program.norms.rows.tolist() == [1, 2, 7, 10, 11]
