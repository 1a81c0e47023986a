"""Stability of an equilibrium at rest under loads."""

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.effect_of_loads import LoadedState

LEAST_GROWTH = 1e-10
"""Growth rate below which an equilibrium counts as neutral [1/s]: it would take centuries."""
NEAR = 0.1
"""Relative distance of the frequencies of modes from a pole within which their damping acts on it."""
UNSTABLE_ROUNDING = 1e-7
"""Share of the loads' largest stiffness in modes of unit mass below which a negative stiffness is rounding."""
EIGENVALUE_ROUNDING = 2e-15
"""Share of the largest squared angular frequency below which a negative square is rounding."""


def loaded_squares(squares: Array, added: Array) -> tuple[Array, float]:
    """Compute the squared angular frequencies of modes under load.

    Args:
        squares: squared angular frequencies without load, ascending, (n,).
        added: stiffness that the loads add, on these modes of unit mass, (n, n).

    Returns:
        The squares under load, by ascending real part, complex (n,), and the size below which they are rounding.
    """
    found = np.linalg.eigvals(np.diag(squares) + added).astype(complex)
    rounding = max(
        UNSTABLE_ROUNDING * np.abs(added).max(initial=0.0), EIGENVALUE_ROUNDING * np.abs(squares).max(initial=0.0)
    )
    return found[np.argsort(found.real)], float(rounding)


def warn_of_instability(assembly: Assembly, loads: LoadedState) -> None:
    """Warn of an equilibrium at rest that is unstable."""
    if instability := describe_instability(assembly, loads.stiffness):
        warn(f"{instability}; the linear model is about it all the same")


def describe_instability(assembly: Assembly, added: Array) -> str:
    """Describe an equilibrium at rest that is unstable by its fastest pole, real unless forces follow a point.

    Forces that follow a point may let two modes of almost the same frequency flutter. Such a pole does not count where
    the damping of these modes is larger.

    Args:
        assembly: the assembled scene.
        added: stiffness that the loads add on modal amplitudes, (n, n).

    Returns:
        The description; empty for a stable equilibrium.
    """
    squares, rounding = loaded_squares(assembly.modal.omega**2, added)
    if not squares.size:
        return ""
    poles = np.sqrt(-squares)
    pole = poles[np.argmax(poles.real)]
    if pole.real <= max(np.sqrt(rounding), LEAST_GROWTH):
        return ""
    flutters = abs(pole.imag) > UNSTABLE_ROUNDING * pole.real
    angular = assembly.modal.omega
    near = np.abs(angular - abs(pole.imag)) < NEAR * abs(pole.imag)
    if near.any() and pole.real < 0.5 * np.diag(assembly.modal.damping.of_modes)[near].min():
        return ""
    text = f"{pole.real:+.5g}" + (f" +- {abs(pole.imag):.5g}i" if flutters else "")
    return (
        f"the equilibrium of scene {assembly.scene.name!r} under its loads is unstable: without damping it has the "
        f"pole {text} rad/s"
    )
