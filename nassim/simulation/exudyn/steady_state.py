"""Equilibria of an Exudyn system in steady rotation or under weight, and their stability.

In steady rotation, positions and Euler parameters x obey x' = V x + v with constant V, so that x'' = V x', and
deformations are constant. Of the equations M x'' = f(x, x') + G(x)' z, g(x) = 0 of the integrated system only the
positions are then unknown; Newton's method finds them. Centrifugal and gyroscopic forces, springs and joints balance
exactly as in the following run, which therefore starts without a transient. With x rotated along and moved by d in the
rotating frame, d' adds d' to x' and 2 V d' to x'': this gives the poles about that state.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import exudyn as exu
import numpy as np
import scipy

from nassim.base.checks import Array
from nassim.base.rigid_motion import skew
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.model.motion_size import scene_size
from nassim.simulation.model.tangents import no_equilibrium
from nassim.systems.linear_model import UnstablePole, as_unstable

DIFFERENCE_STEP = 1e-6
"""Step of central differences: [m], [-] for Euler parameters, and modes in their own unit."""
CLOSE = 1e-9
"""Newton's last step over the speed of the rotation, both as square roots of energy."""
LONGEST_STEP = 0.25
"""Longest step over the speed of the rotation: some half a radian of a pendulum."""
SHUT = 1e-12
"""Largest violation of constraints at the end [m], [-]."""
NEWTON_ITERATIONS = 30
STIFFNESS_ROUNDING = 1e-6
"""Stiffness over that of the spin, and force over the largest, that are rounding of differences."""
SOFT = 1e-9
"""Stiffness of modes, over the largest, below which it is not distinguished from zero."""
GROWS = 1e-3
"""Growth rate over the speed below which it is not distinguished from the drift of a rigid-body mode."""
SWAYS = 1e-6
"""Way of the equilibrium within a radian over the speed, as square roots of energy, that is rounding."""
ASKEW = 1e-5
"""Growth rate over the pole's absolute value below which it is rounding."""
NO_REST = (
    "no spinning equilibrium to start from: centrifugal forces and weight drive a motion that nothing holds; add a "
    'spring or a joint, change the speed, or start from the reference configuration by simulate(..., start="released")'
)


@dataclass(frozen=True)
class _SteadyEquations:
    """The system's equations of motion, with V (n, n) and v (n,) of its rotation."""

    system: System
    solver: Any
    turn: Array
    shift: Array

    @classmethod
    def of(cls, system: System, twists: Mapping[str, Array]) -> "_SteadyEquations":
        """Make the equations of a system with twists of its bodies."""
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
                continue  # the node may be of any kind
            place, scalar, vector = slice(first, first + 3), first + 3, slice(first + 4, first + 7)
            turn[place, place], shift[place] = skew(twist[3:]), twist[:3]
            turn[scalar, vector], turn[vector, scalar] = -twist[3:] / 2, twist[3:] / 2
            turn[vector, vector] = skew(twist[3:]) / 2
        return cls(system, solver, turn, shift)

    def rates(self, x: Array) -> Array:
        """Return x' in steady rotation, (n,)."""
        return self.turn @ x + self.shift

    def forces_after(self, time: float, x: Array) -> Array:
        """Return what `left` has become after a time of steady rotation from x, along axes that have turned, (n,)."""
        n = len(x)
        turned = scipy.linalg.expm(time * np.block([[self.turn, self.shift[:, None]], [np.zeros((1, n + 1))]]))
        left: Array = turned[:n, :n].T @ self.left(turned[:n, :n] @ x + turned[:n, n])
        return left

    def _put(self, x: Array, rates: Array) -> None:
        data = self.system.mbs.systemData
        reference = data.GetODE2Coordinates(exu.ConfigurationType.Reference)
        data.SetODE2Coordinates(x - reference, exu.ConfigurationType.Current)
        data.SetODE2Coordinates_t(rates, exu.ConfigurationType.Current)

    def forces(self, x: Array, rates: Array) -> Array:
        """Return f, (n,)."""
        self._put(x, rates)
        self.solver.ComputeODE2RHS(self.system.mbs)
        return self.solver.GetSystemResidual()[: len(x)]

    def mass(self, x: Array) -> Array:
        """Return M, (n, n)."""
        self._put(x, self.rates(x))
        self.solver.ComputeMassMatrix(self.system.mbs)
        return self.solver.GetSystemMassMatrix()[: len(x), : len(x)]

    def left(self, x: Array) -> Array:
        """Return the forces that constraints must bear, forces less inertia, (n,)."""
        rates = self.rates(x)
        return self.forces(x, rates) - self.mass(x) @ (self.turn @ rates)

    def constraints(self, x: Array) -> tuple[Array, Array]:
        """Return the violations g, (m,), and their derivatives G, (m, n)."""
        mbs, n = self.system.mbs, len(x)
        self._put(x, self.rates(x))
        self.solver.ComputeAlgebraicEquations(mbs)
        violations = self.solver.GetSystemResidual()[n:]
        self.solver.ComputeJacobianODE2RHS(mbs, scalarFactor_ODE2=0.0, scalarFactor_ODE2_t=0.0, scalarFactor_ODE1=0.0)
        self.solver.ComputeJacobianAE(mbs, scalarFactor_ODE2=1.0)
        rows = self.solver.GetSystemJacobian()[n:, :n]
        held = np.any(rows, axis=1)  # a free direction of a joint has an empty row
        return violations[held], rows[held]


@dataclass(frozen=True)
class _Motion:
    """Small motion about x, where the constraints leave k motions of the n coordinates.

    Attributes:
        allowed: modes of the system in the rotating frame without constraint forces, of unit mass, corrected to what
            joints allow, (n, k): on a deformed body the two differ in Exudyn.
        back: motion that removes the violations of constraints, (n,).
        opened: largest violation of constraints.
        push: forces along the uncorrected modes after that motion, (k,).
        stiffness: stiffness, (k, k).
        squares: squared frequencies, without the skew part of the stiffness, (k,).
    """

    allowed: Array
    back: Array
    opened: float
    push: Array
    stiffness: Array
    squares: Array

    @classmethod
    def about(cls, equations: _SteadyEquations, x: Array) -> "_Motion":
        """Linearise the equations about x, (n,)."""
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
        modes = free @ shapes
        closes = np.linalg.pinv(opens)
        allowed, back = modes - closes @ (opens @ modes), -closes @ violations
        push = modes.T @ (left + rows.T @ multipliers - stiffness @ back)
        opened = float(np.abs(violations).max(initial=0.0))
        return cls(allowed, back, opened, push, modes.T @ stiffness @ allowed, squares)

    def step(self, speed: float, energy: float) -> tuple[Array, float]:
        """Compute Newton's step.

        Args:
            speed: speed of the rotation [rad/s].
            energy: square root of the energy of the rotation.

        Returns:
            The step (n,), and its size as a square root of energy.

        Raises:
            RuntimeError: if a force meets no stiffness.
        """
        # Each motion is scaled to its own stiffness, soft ones to that of the spin, above rounding.
        softest = max(speed**2, SOFT * np.abs(self.squares).max(initial=0.0))
        scale = 1 / np.sqrt(np.maximum(np.abs(self.squares), softest))
        u, values, v = np.linalg.svd(scale[:, None] * self.stiffness * scale)
        pushed, held = u.T @ (scale * self.push), values > STIFFNESS_ROUNDING
        if np.any(np.abs(pushed[~held]) > STIFFNESS_ROUNDING * energy):
            raise RuntimeError(NO_REST)
        going = v[held].T @ (pushed[held] / values[held])
        return self.back + self.allowed @ (scale * going), float(np.abs(going).max(initial=0.0))

    def poles(self, equations: _SteadyEquations, x: Array) -> Array:
        """Return the poles in the rotating frame [rad/s], with the symmetric part of the stiffness.

        The skew part of the stiffness is an artefact of Exudyn's joints.
        """
        rates, mass, k = equations.rates(x), equations.mass(x), len(self.squares)
        forces = 2 * mass @ equations.turn @ self.allowed
        forces -= _slopes(lambda rates: equations.forces(x, rates), rates, self.allowed)
        inverse = np.linalg.inv(self.allowed.T @ mass @ self.allowed)
        stiffness = 0.5 * (self.stiffness + self.stiffness.T)
        state = np.block([[np.zeros((k, k)), np.eye(k)], [-inverse @ stiffness, -inverse @ self.allowed.T @ forces]])
        return np.linalg.eigvals(state)


def coordinates_at_start(system: System) -> Array:
    """Return the coordinates at the start, positions, Euler parameters and deformations, (n,)."""
    data = system.mbs.systemData
    start: Array = data.GetODE2Coordinates(exu.ConfigurationType.Reference)
    return start + data.GetODE2Coordinates(exu.ConfigurationType.Initial)


def solve_steady_rotation(system: System, twists: Mapping[str, Array]) -> tuple[tuple[UnstablePole, ...], float | None]:
    """Bring the system to equilibrium in steady rotation and make that the initial state.

    Where the equilibrium is neutral, free coordinates stay at their values.

    Args:
        system: the system.
        twists: constant twists of all moving bodies, see
            `nassim.simulation.model.initial_velocities.steady_rotation_twists`.

    Returns:
        Unstable poles about the equilibrium, and how far points of the bodies in equilibrium move on the rotor as it
        turns by a radian [m], None where the rotation is steady.

    Raises:
        RuntimeError: if there is no equilibrium.
    """
    equations = _SteadyEquations.of(system, twists)
    speed = max(float(np.linalg.norm(twist[3:])) for twist in twists.values())
    falling = _falling(system)  # a slow rotation has less energy than its weight

    def energy_root(x: Array) -> float:
        rates = equations.rates(x)
        return float(np.hypot(np.sqrt(rates @ equations.mass(x) @ rates), falling))

    return _come_to_rest(equations, speed, energy_root)


def squares_at_rest(system: System) -> Array:
    """Return the squared angular frequencies about the equilibrium in which a system starts at rest, ascending, (k,).

    Args:
        system: the system at rest in equilibrium.
    """
    equations = _SteadyEquations.of(system, {name: np.zeros(6) for name in system.nodes})
    return _Motion.about(equations, coordinates_at_start(system)).squares


def solve_loaded_equilibrium(system: System) -> None:
    """Bring the system into a static equilibrium that its weight may stiffen, and make that the initial state.

    Where the equilibrium is neutral, free coordinates stay at their values.

    Args:
        system: the system at rest, with gravity.

    Raises:
        RuntimeError: if there is no stable equilibrium.
    """
    scene, falling = system.assembly.scene, _falling(system)
    if not falling:
        raise RuntimeError(no_equilibrium(scene))
    equations = _SteadyEquations.of(system, {name: np.zeros(6) for name in system.nodes})
    speed = float(np.sqrt(np.linalg.norm(scene.gravity) / scene_size(scene)))
    if _come_to_rest(equations, speed, lambda _: falling)[0]:
        raise RuntimeError(no_equilibrium(scene))


def _falling(system: System) -> float:
    """Return the square root of the energy by which a scene falls through its size."""
    scene = system.assembly.scene
    mass = sum(body.rigid_inertia[0] for body in scene.bodies if body.moves)
    return float(np.sqrt(2 * mass * np.linalg.norm(scene.gravity) * scene_size(scene)))


def _come_to_rest(
    equations: _SteadyEquations, speed: float, energy_root: Callable[[Array], float]
) -> tuple[tuple[UnstablePole, ...], float | None]:
    """Find the equilibrium of a system and make it the initial state.

    Args:
        equations: equations of the system.
        speed: speed of the rotation, or of a pendulum under its weight [rad/s].
        energy_root: square root of the energy of the rotation, or of the fall, as a function of the coordinates.

    Returns:
        Unstable poles, fastest growth first, and the way of the equilibrium, see `solve_steady_rotation`.

    Raises:
        RuntimeError: if there is no equilibrium.
    """
    data = equations.system.mbs.systemData
    reference = data.GetODE2Coordinates(exu.ConfigurationType.Reference)
    x = coordinates_at_start(equations.system)
    for _ in range(NEWTON_ITERATIONS):
        if not np.all(np.isfinite(equations.left(x))):
            break
        energy = energy_root(x)
        try:
            motion = _Motion.about(equations, x)
            step, size = motion.step(speed, energy)
        except np.linalg.LinAlgError:  # so far from rest that a body's mass matrix is not positive definite
            break
        x = x + step * (LONGEST_STEP * energy / size if size > LONGEST_STEP * energy else 1.0)
        if size < CLOSE * energy and motion.opened < SHUT:
            # Both change the present state.
            found = _growing(motion.poles(equations, x), speed), _sway(equations, motion, x, speed, energy)
            for kind in (exu.ConfigurationType.Initial, exu.ConfigurationType.Current):
                data.SetODE2Coordinates(x - reference, kind)
                data.SetODE2Coordinates_t(equations.rates(x), kind)
                data.SetODE2Coordinates_tt(equations.turn @ equations.rates(x), kind)  # accelerometers read it at rest
            return found
    raise RuntimeError(NO_REST)


def _sway(equations: _SteadyEquations, motion: _Motion, x: Array, speed: float, energy: float) -> float | None:
    """Return how far points of bodies in equilibrium x move along axes that turn by a radian [m]; None for rounding."""
    change = motion.allowed.T @ (equations.forces_after(1 / speed, x) - equations.left(x))
    try:
        step, size = replace(motion, push=change, back=np.zeros(len(x))).step(speed, energy)
    except RuntimeError:  # nothing holds what is pushed
        return np.inf
    if size <= SWAYS * energy:
        return None
    system, ways = equations.system, [0.0]
    from_reference = x - system.mbs.systemData.GetODE2Coordinates(exu.ConfigurationType.Reference)
    for name, own in system.bodies.items():
        places = [system.mbs.GetNodeODE2Index(node) + k for node, count in own.nodes for k in range(count)]
        state = own.state(from_reference[places])
        points = system.assembly.scene.body(name).point_names
        ways += [float(np.linalg.norm(state.motion(point)[:3] @ step[places])) for point in points]
    return max(ways)


def _growing(poles: Array, speed: float) -> tuple[UnstablePole, ...]:
    """Return the unstable poles, fastest growth first."""
    least = max(GROWS * speed, 10 * np.sqrt(np.finfo(float).eps) * np.abs(poles).max(initial=0.0))
    return as_unstable(poles[poles.real > np.maximum(least, ASKEW * np.abs(poles))])


def _slopes(function: Callable[[Array], Array], x: Array, along: Array | None = None) -> Array:
    """Return derivatives of a function of x along columns (n, k), by central differences."""
    directions = np.eye(len(x)) if along is None else along
    columns = [
        (function(x + DIFFERENCE_STEP * e) - function(x - DIFFERENCE_STEP * e)) / (2 * DIFFERENCE_STEP)
        for e in directions.T
    ]
    return np.column_stack(columns) if columns else np.zeros((len(x), 0))
