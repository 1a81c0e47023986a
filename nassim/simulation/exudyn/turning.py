"""Where an Exudyn system that turns at a constant speed comes to rest on its turntable, and whether it stays there.

Where every body goes on along its own circle, positions and Euler parameters x obey x' = V x + v with constant V, so
that x'' = V x', and deformations stand still. Left in the equations M x'' = f(x, x') + G(x)' z, g(x) = 0 of the system
as it is integrated are the positions, which Newton's rule finds: centrifugal and gyroscopic forces, springs and joints
bear upon each other exactly as in the run that follows, which so has nothing to ring about. With x turned along and
moved by d on the turntable, d' adds d' to x' and 2 V d' to x'': the poles about that state.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import exudyn as exu
import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.simulation.exudyn.state import System
from nassim.simulation.model.assembly import NO_EQUILIBRIUM
from nassim.systems.linear_model import UnstablePole

STEP = 1e-6
"""Of central differences: [m], [-] of Euler parameters, and of modes in their own unit."""
CLOSE = 1e-9
"""Newton's last step over the speed of the turn, both as roots of energy."""
LONGEST = 0.25
"""Longest step over the same: some half a radian of a pendulum."""
SHUT = 1e-12
"""What may be open at joints in the end [m], [-]."""
ITERATIONS = 30
HELD = 1e-6
"""Stiffness over that of the spin, and force over the largest, that are the rounding of differences."""
SOFT = 1e-9
"""Stiffness over the largest, of modes, below which it cannot be told well from none."""
GROWS = 1e-3
"""Growth rate over the speed below which it is not told from the drift of a free motion."""
ASKEW = 1e-5
"""Growth rate over the pole's own size below which it is rounding."""
NO_REST = (
    "no spinning equilibrium to start from: centrifugal forces and weight drive a motion that nothing holds; add a "
    'spring or a joint, change the speed, or let the scene go as it is drawn by simulate(..., start="released")'
)


@dataclass(frozen=True)
class _Equations:
    """The system's equations of motion, and V (n, n) and v (n,) of its turn."""

    system: System
    solver: Any
    turn: Array
    shift: Array

    @classmethod
    def of(cls, system: System, twists: Mapping[str, Array]) -> "_Equations":
        solver: Any = exu.MainSolverStatic()
        settings = exu.SimulationSettings()
        settings.solution.file.write = False
        settings.staticSolver.verboseMode = 0
        solver.InitializeSolver(system.mbs, settings)
        n = solver.GetODE2size()
        turn, shift = np.zeros((n, n)), np.zeros(n)
        for name, node in system.nodes.items():
            first, twist = system.mbs.GetNodeODE2Index(node), twists[name]
            if not twist.any():
                continue  # of any kind of node
            place, scalar, vector = slice(first, first + 3), first + 3, slice(first + 4, first + 7)
            turn[place, place], shift[place] = skew(twist[3:]), twist[:3]
            turn[scalar, vector], turn[vector, scalar] = -twist[3:] / 2, twist[3:] / 2
            turn[vector, vector] = skew(twist[3:]) / 2
        return cls(system, solver, turn, shift)

    def rates(self, x: Array) -> Array:
        return self.turn @ x + self.shift

    def _put(self, x: Array, rates: Array) -> None:
        data = self.system.mbs.systemData
        drawn = data.GetODE2Coordinates(exu.ConfigurationType.Reference)
        data.SetODE2Coordinates(x - drawn, exu.ConfigurationType.Current)
        data.SetODE2Coordinates_t(rates, exu.ConfigurationType.Current)

    def forces(self, x: Array, rates: Array) -> Array:
        """f, (n,)."""
        self._put(x, rates)
        self.solver.ComputeODE2RHS(self.system.mbs)
        result: Array = self.solver.GetSystemResidual()[: len(x)]
        return result

    def mass(self, x: Array) -> Array:
        """M, (n, n)."""
        self._put(x, self.rates(x))
        self.solver.ComputeMassMatrix(self.system.mbs)
        result: Array = self.solver.GetSystemMassMatrix()[: len(x), : len(x)]
        return result

    def left(self, x: Array) -> Array:
        """What constraints must bear, (n,): forces less inertia."""
        rates = self.rates(x)
        return self.forces(x, rates) - self.mass(x) @ (self.turn @ rates)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Violations g, (m,), and their derivatives G, (m, n)."""
        mbs, n = self.system.mbs, len(x)
        self._put(x, self.rates(x))
        self.solver.ComputeAlgebraicEquations(mbs)
        violations = self.solver.GetSystemResidual()[n:]
        self.solver.ComputeJacobianODE2RHS(mbs, scalarFactor_ODE2=0.0, scalarFactor_ODE2_t=0.0, scalarFactor_ODE1=0.0)
        self.solver.ComputeJacobianAE(mbs, scalarFactor_ODE2=1.0)
        rows = self.solver.GetSystemJacobian()[n:, :n]
        held = np.any(rows, axis=1)  # what a joint leaves free has an empty row
        return violations[held], rows[held]


@dataclass(frozen=True)
class _Motion:
    """What moves about x, to first order, where k motions remain to the n coordinates.

    tests: motions along which joints do not pull, of unit mass, (n, k), one by one those of the system on its turntable
    allowed: the same, corrected to what joints allow, (n, k): on a deformed body Exudyn takes the one for the other
    back: that closes what is open at the joints, (n,); opened: the most of it
    push: along the tests after that, (k,); stiffness: (k, k); squares: of frequencies, but for what is skew in it, (k,)
    """

    tests: Array
    allowed: Array
    back: Array
    opened: float
    push: Array
    stiffness: Array
    squares: Array

    @classmethod
    def about(cls, equations: _Equations, x: Array) -> "_Motion":
        mass, left = equations.mass(x), equations.left(x)
        violations, rows = equations.constraints(x)
        multipliers = np.linalg.lstsq(rows.T, -left, rcond=None)[0]

        def borne(x: Array) -> Array:
            violations, rows = equations.constraints(x)
            return np.concatenate([equations.left(x) + rows.T @ multipliers, violations])

        slopes = _slopes(borne, x)
        stiffness, opens = -slopes[: len(x)], slopes[len(x) :]
        free = scipy.linalg.null_space(rows) if len(rows) else np.eye(len(x))
        own = free.T @ stiffness @ free
        squares, shapes = np.zeros(0), np.zeros((0, 0))
        if own.size:  # SciPy before 1.14 takes no empty matrix
            squares, shapes = scipy.linalg.eigh(0.5 * (own + own.T), free.T @ mass @ free)
        tests = free @ shapes
        closes = np.linalg.pinv(opens)
        allowed, back = tests - closes @ (opens @ tests), -closes @ violations
        push = tests.T @ (left + rows.T @ multipliers - stiffness @ back)
        opened = float(np.abs(violations).max(initial=0.0))
        return cls(tests, allowed, back, opened, push, tests.T @ stiffness @ allowed, squares)

    def step(self, speed: float, turning: float) -> tuple[Array, float]:
        """Newton's step (n,), and its size as a root of energy.

        turning: root of the energy of the turn. Raises RuntimeError where a push meets no stiffness.
        """
        # Each motion is scaled to its own stiffness, soft ones to that of the spin, which a stiff one would drown.
        softest = max(speed**2, SOFT * np.abs(self.squares).max(initial=0.0))
        scale = 1 / np.sqrt(np.maximum(np.abs(self.squares), softest))
        u, values, v = np.linalg.svd(scale[:, None] * self.stiffness * scale)
        pushed, held = u.T @ (scale * self.push), values > HELD
        if np.any(np.abs(pushed[~held]) > HELD * turning):
            raise RuntimeError(NO_REST)
        going = v[held].T @ (pushed[held] / values[held])
        return self.back + self.allowed @ (scale * going), float(np.abs(going).max(initial=0.0))

    def poles(self, equations: _Equations, x: Array) -> Array:
        """In the frame that turns [rad/s], where all stiffness is there: symmetric, whatever Exudyn's joints feign."""
        rates, mass, k = equations.rates(x), equations.mass(x), len(self.squares)
        forces = 2 * mass @ equations.turn @ self.allowed
        forces -= _slopes(lambda rates: equations.forces(x, rates), rates, self.allowed)
        inverse = np.linalg.inv(self.allowed.T @ mass @ self.allowed)
        stiffness = 0.5 * (self.stiffness + self.stiffness.T)
        state = np.block([[np.zeros((k, k)), np.eye(k)], [-inverse @ stiffness, -inverse @ self.allowed.T @ forces]])
        result: Array = np.linalg.eigvals(state)
        return result


def solve_turning(system: System, twists: Mapping[str, Array]) -> tuple[UnstablePole, ...]:
    """Bring the system to rest on its turntable, keep that as the initial state; returns what grows there by itself.

    twists: of all moving bodies, constant, see `nassim.simulation.model.initial_velocities.steady_rotation_twists`

    Where the equilibrium is neutral, what moves freely stays where it is. Raises RuntimeError without one.
    """
    equations = _Equations.of(system, twists)
    speed = max(float(np.linalg.norm(twist[3:])) for twist in twists.values())

    def turning(x: Array) -> float:
        rates = equations.rates(x)
        return float(np.sqrt(rates @ equations.mass(x) @ rates))

    return _come_to_rest(equations, speed, turning)


def solve_hanging(system: System, size: float) -> None:
    """Bring the system into a static equilibrium that its weight may stiffen, keep that as the initial state.

    Args:
        system: at rest, with gravity.
        size: of its scene [m].

    Where the equilibrium is neutral, what moves freely stays where it is. Raises RuntimeError without a stable one.
    """
    scene = system.assembly.scene
    gravity = float(np.linalg.norm(scene.gravity))
    if not gravity:
        raise RuntimeError(NO_EQUILIBRIUM)
    mass = sum(body.rigid_inertia[0] for body in scene.bodies if body.moves)
    falling = float(np.sqrt(2 * mass * gravity * size))
    equations = _Equations.of(system, {name: np.zeros(6) for name in system.nodes})
    if _come_to_rest(equations, float(np.sqrt(gravity / size)), lambda _: falling):
        raise RuntimeError(NO_EQUILIBRIUM)


def _come_to_rest(equations: _Equations, speed: float, turning: Callable[[Array], float]) -> tuple[UnstablePole, ...]:
    """Find where a system rests and keep that as its initial state; returns what grows there by itself.

    Args:
        equations: of the system.
        speed: of the turn, or of what swings under its weight [rad/s].
        turning: root of the energy of the turn, or of what falls, by coordinates.

    Raises RuntimeError where it comes to no rest.
    """
    data = equations.system.mbs.systemData
    drawn = data.GetODE2Coordinates(exu.ConfigurationType.Reference)
    x = drawn + data.GetODE2Coordinates(exu.ConfigurationType.Initial)
    for _ in range(ITERATIONS):
        if not np.all(np.isfinite(equations.left(x))):
            break
        energy = turning(x)
        motion = _Motion.about(equations, x)
        step, size = motion.step(speed, energy)
        x = x + step * min(1.0, LONGEST * energy / max(size, np.finfo(float).tiny))
        if size < CLOSE * energy and motion.opened < SHUT:
            for kind in (exu.ConfigurationType.Initial, exu.ConfigurationType.Current):
                data.SetODE2Coordinates(x - drawn, kind)
                data.SetODE2Coordinates_t(equations.rates(x), kind)
            return _growing(motion.poles(equations, x), speed)
    raise RuntimeError(NO_REST)


def _growing(poles: Array, speed: float) -> tuple[UnstablePole, ...]:
    """What grows, fastest first."""
    least = max(GROWS * speed, 10 * np.sqrt(np.finfo(float).eps) * np.abs(poles).max(initial=0.0))
    growing = poles[(poles.real > np.maximum(least, ASKEW * np.abs(poles))) & (poles.imag >= 0)]
    return tuple(UnstablePole(float(s.imag) / (2 * np.pi), float(s.real)) for s in growing[np.argsort(-growing.real)])


def _slopes(function: Callable[[Array], Array], x: Array, along: Array | None = None) -> Array:
    """Derivatives of a function of x along columns (n, k), by central differences."""
    directions = np.eye(len(x)) if along is None else along
    columns = [(function(x + STEP * e) - function(x - STEP * e)) / (2 * STEP) for e in directions.T]
    return np.column_stack(columns) if columns else np.zeros((len(x), 0))
