"""Equilibrium of a scene under constant loads, of first order in them, and what its parts bear there."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.scene.bodies import FlexibleBody
from nassim.simulation.loaded.geometric_stiffness import spring_forces
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.coordinates import Coordinates
from nassim.simulation.model.displacement import change_of_directions, displaced
from nassim.simulation.model.motion_size import motion_sizes
from nassim.simulation.model.moved_coordinates import MovedCoordinates
from nassim.simulation.model.tangents import nonlinear_equilibrium

NOT_SMALL = 0.1
"""Largest error of a model of small motion about an equilibrium: about the rotation [rad] or its square."""
WARNED_ERROR = 0.01
"""Error above which a warning is given."""
SPIN_ROUNDING = 1e-9
"""Stiffness over a mode's own, and force over the largest, that are rounding."""


@dataclass(frozen=True)
class StaticBalance:
    """How a scene bears constant forces.

    Attributes:
        displacement: elastic displacement in all coordinates, (n_all,).
        borne: forces that constraints bear, (n_all,).
        acceleration: acceleration of rigid-body modes, which bear no force, in all coordinates, (n_all,).
    """

    displacement: Array
    borne: Array
    acceleration: Array


def balance(assembly: Assembly, force: Array, moved: Array | float = 0.0) -> StaticBalance:
    """Compute how a scene bears forces, (n_all,), and a displacement by its drives, (n_all,).

    The result is of first order in the forces, except in nonlinear springs, so it does not depend on the description of
    the scene, and a motion without stiffness, as a rotation about the axis of a spin, keeps none.
    """
    modal, circuits = assembly.modal, assembly.signals.port_circuits
    modes, elastic = modal.modes, ~modal.rigid_modes
    bent, loose = modes[:, elastic], modes[:, ~elastic]
    stiffness = assembly.signals.discharged(np.diag(modal.omega[elastic] ** 2), bent)
    q = bent @ np.linalg.solve(stiffness, bent.T @ force)
    if not assembly.is_linear:
        laws = [(tangent.law, tangent.rows) for tangent in assembly.tangents]
        q = nonlinear_equilibrium(assembly.coordinates, laws, modal.basis, force)
    q = q + moved
    left, acceleration = force - spring_forces(assembly.tangents, q), loose @ (loose.T @ force)
    for name, place in assembly.coordinates.slices.items():
        body = assembly.scene.body(name)
        left[place] -= body.mass_matrix @ acceleration[place]
        if isinstance(body, FlexibleBody) and body.deforms:
            root = body.reduced.strain.root
            left[place] -= root.T @ (root @ q[place])
    for circuit in circuits:
        left += circuit.forces * (circuit.forces @ q) / circuit.storage
    return StaticBalance(q, left, acceleration)


def moved_by_drives(assembly: Assembly, values: Mapping[str, float]) -> Array:
    """Return the displacement at rest by drives that follow inputs, in all coordinates, (n_all,)."""
    drives, names = assembly.signals.prescribed, assembly.scene.inputs
    moved: Array = drives.motion @ [values.get(names[index], 0.0) for index in drives.inputs]
    if not moved.any():
        return moved
    if not assembly.is_linear:
        raise ValueError(
            "a stroke is a load of linear scenes only, and this one has a nonlinear spring: let a force act in place "
            "of the drive, and scale by the displacement that it causes"
        )
    # The motion keeps the charge of ports with a resistance, which is gone at rest.
    circuits = assembly.signals.port_circuits
    charged = sum((one.forces * (one.forces @ moved) / one.storage for one in circuits), np.zeros(len(moved)))
    return moved + balance(assembly, charged).displacement


def spinning_amplitudes(assembly: Assembly, added: Array, force: Array, rate: float, largest: float) -> Array:
    """Return modal amplitudes in equilibrium under forces on all coordinates, with the stiffness of a spin added, (n,).

    Each mode is scaled by its own stiffness, a rigid-body mode by that of the spin, because the rounding of a stiff
    mode would hide that.

    Args:
        assembly: the assembled scene.
        added: stiffness that the loads add on modal amplitudes, (n, n).
        force: centrifugal forces, (n_all,).
        rate: rate of the spin [rad/s].
        largest: largest force that a mode of unit mass can have.

    Returns:
        The amplitudes.

    Raises:
        ValueError: if centrifugal forces drive a motion that nothing holds.
    """
    modal, modes, free = assembly.modal, assembly.modal.modes, assembly.modal.rigid_modes
    matrix = assembly.signals.discharged(added, modes)
    scale = 1 / np.where(free, rate, modal.omega)
    axes, values, answers = np.linalg.svd(np.diag(np.where(free, 0.0, 1.0)) + scale[:, None] * matrix * scale)
    pushed = axes.T @ (scale * (modes.T @ force))
    held = values > SPIN_ROUNDING
    if np.any(np.abs(pushed[~held]) > SPIN_ROUNDING * largest / rate):
        raise ValueError(
            f"scene {assembly.scene.name!r} has no spinning equilibrium: centrifugal forces drive a motion that "
            "nothing holds, or that is at its critical speed; add a spring or a joint, put the centre of mass on the "
            "axis, or change the speed"
        )
    return scale * (answers[held].T @ (pushed[held] / values[held]))


def is_at_equilibrium(assembly: Assembly, partition: object = None) -> bool:
    """Return whether a model is about the equilibrium, see `about_equilibrium`."""
    return partition is None and not np.any(assembly.modal.rigid_modes)


def check_small(coordinates: Coordinates, values: Array, loads: str, *, settled: bool = False) -> None:
    """Check that an equilibrium is small motion.

    Args:
        coordinates: coordinates of the scene.
        values: their values in equilibrium, to first order in the loads, (n_all,).
        loads: what brings the scene there, for messages.
        settled: whether the model is about the equilibrium, see `is_at_equilibrium`. Rotations then cause no
            error, but one of these values, from which the iterations start: it grows with the square of the rotations.
            Deformation is always of first order.

    Raises:
        ValueError: for an error above `NOT_SMALL`.

    Warns:
        UserWarning: for an error of the model above `WARNED_ERROR`.
    """
    sizes = motion_sizes(coordinates, values[:, None])
    name = max(sizes, key=lambda name: float(sizes[name].max()), default="")
    rotation, deformation = sizes[name] if name else (0.0, 0.0)
    along_path = isinstance(coordinates, MovedCoordinates)
    change = 0.0 if along_path else change_of_directions(coordinates, displaced(coordinates, values))
    turned, deformed = max(float(rotation), change), max((float(size[1]) for size in sizes.values()), default=0.0)
    found = (
        f"under {loads}, body {name!r} comes to rest rotated by {rotation:.2g} rad and deformed by "
        f"{100 * deformation:.2g} % of its size from the reference configuration"
    )
    if not along_path:
        found += f", and directions of joints and springs change by up to {100 * change:.2g} %"
    if max(turned**2 if settled else turned, deformed) > NOT_SMALL:
        raise ValueError(
            f"{found}, which is no small motion: start nearer to that equilibrium; with bodies in large motion, "
            "static_response finds it, and exudyn_eigenfrequencies(scene, loaded=True) its modes"
        )
    error = deformed if settled else max(turned, deformed)
    if error > WARNED_ERROR:
        warn(f"{found}; results about that equilibrium, such as frequencies, are off by up to some {100 * error:.2g} %")
