"""Errors of time steps: periods and damping of modes in generalized-alpha."""

import numpy as np

from nassim.base.checks import Array
from nassim.base.modal import eigenmodes
from nassim.scene.scene import Scene
from nassim.simulation.model.assembly import Assembly, assemble
from nassim.simulation.model.period_correction import Steps, correct_periods, small_motion_factors

NO_EFFECT = 1e-6
"""Relative change of a frequency, or damping ratio, below which steps have no effect that is worth a line."""
WORTH_TELLING = 0.01
"""Relative error of what loops' commands do to a mode from which a line tells it."""


def integrator_error(frequency: float, time_step: float, *, spectral_radius: float = 1.0) -> tuple[float, float]:
    """Compute the effect of generalized-alpha alone on an undamped mode: relative period error and damping ratio.

    The period is 2 pi over the absolute value of the mode's pole. Simulations correct its lengthening where they can,
    which increases the damping: see `period_errors` and `numerical_damping` for the remaining errors of a scene.

    Args:
        frequency: frequency of the mode [Hz].
        time_step: time step [s].
        spectral_radius: as in `simulate` [-].

    Returns:
        Relative lengthening of the period [-], and damping ratio [-].

    Source: J. Chung, G. M. Hulbert, A time integration algorithm for structural dynamics with improved numerical
    dissipation: the generalized-alpha method, J. Appl. Mech. 60 (1993) 371-375, equations 2 to 4 and 25.
    """
    angle = 2 * np.pi * frequency * time_step
    alpha_m, alpha_f, gamma, beta = Steps(time_step, spectral_radius).coefficients
    # Displacement, step x velocity, step^2 x acceleration.
    new = np.array([[1, 0, -beta], [0, 1, -gamma], [(1 - alpha_f) * angle**2, 0, 1 - alpha_m]])
    old = np.array([[1, 1, 0.5 - beta], [0, 1, 1 - gamma], [-alpha_f * angle**2, 0, -alpha_m]])
    values = np.linalg.eigvals(np.linalg.solve(new, old))
    root = np.log(values[np.argmax(values.imag)])
    return float(angle / abs(root) - 1), max(0.0, round(float(-root.real / abs(root)), 12))


def period_errors(scene: Scene | Assembly, time_step: float, *, spectral_radius: float = 1.0) -> Array:
    """Compute the relative error of each undamped mode's frequency in a simulation by generalized-alpha.

    Simulations correct the rule's period error mode by mode: exactly in small motion and where only bodies deform, up
    to 3.5 steps a period. In large motion they correct less where springs, bushings or rigid bodies share in a mode,
    which then keeps a part of the rule's own error, at most that of `integrator_error`. They do not correct small
    motion with drives that follow inputs. Motion forced at a frequency f far above a mode stays too small, by
    (2 pi f h)^2 / 6.

    Args:
        scene: the scene, or its assembly.
        time_step: time step h [s].
        spectral_radius: as in `simulate` [-].

    Returns:
        Relative errors, (n,) [-]; 0 for rigid-body modes. The modes' frequencies, in the same order, are
        `assemble(scene).modal.frequency` of `nassim.simulation` [Hz].
    """
    assembly = scene if isinstance(scene, Assembly) else assemble(scene)
    return _stepped_modes(assembly, Steps(time_step, spectral_radius))[0]


def numerical_damping(scene: Scene | Assembly, time_step: float, *, spectral_radius: float = 1.0) -> Array:
    """Compute the damping ratio that generalized-alpha adds to each undamped mode of a scene.

    It is larger than that of `integrator_error`: period correction takes mass from modes, which are then as fast, in
    steps, as modes above them.

    Args:
        scene: the scene, or its assembly.
        time_step: time step [s].
        spectral_radius: as in `simulate` [-].

    Returns:
        Damping ratios, (n,) [-]; 0 for rigid-body modes.
    """
    assembly = scene if isinstance(scene, Assembly) else assemble(scene)
    return _stepped_modes(assembly, Steps(time_step, spectral_radius))[1]


def _stepped_modes(assembly: Assembly, steps: Steps) -> tuple[Array, Array]:
    """Return the relative frequency errors and damping ratios of undamped modes in steps, (n,) each."""
    frequency, rigid = assembly.modal.frequency, assembly.modal.rigid_modes
    if assembly.scene.in_small_motion:
        mass = np.diag(small_motion_factors(assembly, frequency, steps)[0])
    else:
        deformation = assembly.modal.damping.deformation @ assembly.modal.shapes
        mass = np.eye(len(frequency)) + deformation.T @ correct_periods(assembly, steps)[1] @ deformation
    model, _ = eigenmodes(np.diag((2 * np.pi * frequency) ** 2), mass)
    options = {"spectral_radius": steps.spectral_radius}
    errors = [integrator_error(f, steps.time_step, **options) if f else (0.0, 0.0) for f in model]
    longer, damping = np.reshape(errors, (-1, 2)).T
    stepped = model / (1 + longer)
    return np.where(rigid, 0.0, stepped / np.where(rigid, 1.0, frequency) - 1), np.where(rigid, 0.0, damping)


def describe_steps(assembly: Assembly, steps: Steps, highest: float) -> str:
    """Describe the effect of a run's steps on modes up to a frequency [Hz] in one line; empty where there is none."""
    below = (assembly.modal.frequency <= highest) & ~assembly.modal.rigid_modes
    if not below.any():
        return ""
    errors, damping = (values[below] for values in _stepped_modes(assembly, steps))
    most = damping.max()
    if max(most, np.abs(errors).max()) < NO_EFFECT:
        return ""
    damped = f" and damp them by up to {100 * most:.2g} % of critical" if most > 0 else ""
    return f"the steps shift modes up to {highest:.4g} Hz by up to {100 * np.abs(errors).max():.2g} %{damped}"


def command_error(frequency: float, time_step: float) -> float:
    """Compute by how much the forces of loops' commands are wrong in generalized-alpha, relative to the commands.

    A command that jumps at a step acts there with the mean of its two values, see
    `nassim.simulation.model.digital_controllers`. The mean force of each step is then (u_before + 2 u + u_after) / 4 in
    place of u, the same whether a sample takes one step or several. Without a delay the next command is not known, and
    the mean force is (3 u + 2 u_before - u_twice_before) / 4. Of a command at a frequency f both differ from u by
    sin^2(pi f h).

    Args:
        frequency: frequency f of the command [Hz].
        time_step: time step h [s].

    Returns:
        Size of the error over that of the command [-].
    """
    return float(np.sin(np.pi * frequency * time_step) ** 2)


def describe_commands(assembly: Assembly, time_step: float) -> str:
    """Describe the slowest mode on which a run's steps change what loops' commands do; empty without such a mode."""
    fastest = max((loop.controller.sample_rate for loop in assembly.scene.loops), default=0.0) / 2
    modes = assembly.modal.frequency[~assembly.modal.rigid_modes]
    changed = [f for f in modes if f <= fastest and command_error(f, time_step) > WORTH_TELLING]
    if not changed:
        return ""
    slowest = min(changed)
    return (
        f"the steps change what loops' commands do to the mode of {slowest:.4g} Hz by "
        f"{100 * command_error(slowest, time_step):.2g} %, and more to faster ones; shorter steps or exact ones help"
    )
