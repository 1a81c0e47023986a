"""Linear buckling of scenes: factors by which loads must grow until the equilibrium becomes unstable."""

from collections.abc import Mapping

import numpy as np

from nassim.base.checks import Array, whole_number
from nassim.base.warning_log import mute_warnings, warn
from nassim.scene.scene import Scene
from nassim.simulation.loaded.first_order_equilibrium import moved_by_drives
from nassim.simulation.loaded.loaded_state import loaded_state
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.recorded_motion import original_coordinates, traced
from nassim.simulation.model.trimming import with_enriched_bodies

NEGLIGIBLE = 1e-12
"""Softening by the loads, and share of the largest softening, below which a softening is rounding."""
ASYMMETRY = 1e-6
"""Share of the largest stiffness of the loads above which its asymmetry is no rounding."""
LARGE_ERROR = 0.02
"""Estimated relative error of a factor above which there is a warning."""


def buckling_factors(
    scene: Scene, *, inputs: Mapping[str, float] | None = None, n: int = 1
) -> tuple[Array, dict[str, Array]]:
    """Compute by which factors gravity and constant inputs must grow until the scene buckles, with the shapes.

    With the stiffness K of the reference configuration and the stiffness S of the forces and stresses under the loads,
    K x + factor S x = 0. All loads grow together. The displacement before buckling is neglected, and with it the change
    of the bodies' shape, as in finite element programs. Rigid-body modes are left out: under gravity a mechanism does
    not buckle but hangs or falls. A factor of one or less means that the scene does not bear its loads.

    Args:
        scene: the scene.
        inputs: constant values of inputs, by name; others are zero. Drives may be among them: strokes, which grow too.
        n: number of factors.

    Returns:
        The smallest positive factors, ascending, (m,) with m at most n, empty if no load softens the scene; and the
        shapes of the bodies that move, by name: coordinates of `FlexibleBody.reduced`, for any trimming, or for a
        rigid body the motion of its centre of mass along the world's axes, (n_coordinates, m) each, of unit strain
        energy.

    Warns:
        UserWarning: where the modes that bodies leave out raise a factor by more than 2 %, with the errors of all
            factors, estimated from the bodies' `enriched` form. The error of the finite elements is not estimated. It
            may be several times that of frequencies, because the stress before buckling has one too: compare factors
            of two meshes.

    Raises:
        ValueError: for a scene without loads, for one that turns, for unknown inputs, and for loads without a
            potential, such as a force that turns with a body.
    """
    n = whole_number("n", n, 1)
    if not np.any(scene.gravity) and not any((inputs or {}).values()):
        raise ValueError(f"scene {scene.name!r} has no load that could grow: give it gravity, or inputs with values")
    if not scene.at_rest:
        raise ValueError(
            f"scene {scene.name!r} has a drive of constant speed or a body with an angular_velocity, and buckling is "
            "one of a scene at rest: give the drive the speed 0 and the bodies no angular_velocity, or raise the loads "
            "in linearize(scene, constant_inputs=...) until unstable_poles finds a pole"
        )
    factors, shapes = _factors_of(scene, inputs or {}, n)
    with mute_warnings():  # given already
        better, _ = _factors_of(with_enriched_bodies(scene), inputs or {}, n)
    errors = factors[: len(better)] / better[: len(factors)] - 1
    if errors.max(initial=0.0) > LARGE_ERROR:
        warn(
            f"scene {scene.name!r}: the modes that its bodies leave out raise buckling factors by "
            f"{', '.join(f'{100 * error:.1f} %' for error in errors)} (estimate); keep more modes"
        )
    return factors, shapes


def _factors_of(scene: Scene, inputs: Mapping[str, float], n: int) -> tuple[Array, dict[str, Array]]:
    """Return the result of `buckling_factors`."""
    assembly = assemble(traced(scene))
    moving = {drive.input for drive in scene.prescribed}
    moved = moved_by_drives(assembly, inputs)
    applied = {name: value for name, value in inputs.items() if name not in moving}
    state = loaded_state(assembly, gravity=scene.gravity, inputs=applied, moved=moved, shape=False, checked=False)
    modal, elastic = assembly.modal, ~assembly.modal.rigid_modes
    scale = 1 / modal.omega[elastic]
    soft = -scale[:, None] * state.stiffness[np.ix_(elastic, elastic)] * scale
    if (soft - soft.T).max(initial=0.0) > ASYMMETRY * np.abs(soft).max(initial=0.0):
        raise ValueError(
            f"scene {scene.name!r} has a force that turns with a body, or a torque about a fixed axis: its work "
            "depends on the path, so the scene may flutter before it buckles, at a load by its masses. Raise the "
            "loads in linearize(scene, constant_inputs=...) until unstable_poles finds a pole"
        )
    softening, combinations = np.linalg.eigh(soft)
    found = np.flatnonzero(softening > NEGLIGIBLE * np.abs(softening).max(initial=1.0))[::-1][:n]
    shapes = (modal.modes[:, elastic] * scale) @ combinations[:, found]
    return 1 / softening[found], original_coordinates(assembly, shapes)
