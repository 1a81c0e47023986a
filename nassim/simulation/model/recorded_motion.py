"""Recorded motion: the motion of a scene's bodies at some steps of a run, in the coordinates of the reduced bodies.

A simulation may model a body with fewer coordinates than it has, see `trim_scene`. A `Trace` then expands them to the
coordinates of the original body.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array, whole_number
from nassim.bodies.readouts import Trace, readouts_of
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.simulation.model.assembly import Assembly, assemble

Pose = tuple[Array, Array]
"""Poses of a body's own frame at n times: positions (n, 3) [m], rotations to the world's axes (n, 3, 3)."""


def recorded_steps(frames: int | Array, n_steps: int, time_step: float) -> Array:
    """Find the numbers of the steps that are nearest to the times of images.

    Args:
        frames: number of images, evenly spread from the first step to the last, or their times [s].
        n_steps: number of steps of the run.
        time_step: time step [s].

    Returns:
        Numbers of the steps, ascending, int (n,).

    Raises:
        ValueError: for fewer than 2 images, for more than there are steps, and for times before or after the run.
    """
    if isinstance(frames, (int, np.integer)):
        if not 2 <= frames <= n_steps + 1:
            raise ValueError(f"frames must be 2 ... {n_steps + 1} in this run, or times; got {frames}")
        return np.round(np.linspace(0, n_steps, frames)).astype(int)
    times = finite_array("frames", frames, (None,))
    steps = np.unique(np.round(times / time_step).astype(int))
    if len(steps) < 2 or steps[0] < 0 or steps[-1] > n_steps:
        raise ValueError(
            f"frames must be at least 2 times within 0 ... {n_steps * time_step:g} s, a time step apart; got "
            f"{len(times)} from {times.min(initial=np.inf):g} s to {times.max(initial=-np.inf):g} s"
        )
    return steps


def traced(scene: Scene) -> Scene:
    """Add to a scene's reduced bodies a trace of their coordinates, which survives trimming.

    `simulate_motion` gives motion in these coordinates: for a machine whose parts were traced, then trimmed to be fast,
    the motion of the same machine with its whole parts, which have surfaces for pictures.
    """
    return replace(scene, bodies=tuple(map(_traced, scene.bodies)))


def _traced(body: Body) -> Body:
    if not isinstance(body, FlexibleBody) or readouts_of(body.reduced.readouts, Trace):
        return body
    trace = Trace(np.eye(len(body.reduced.mass_matrix)))
    return replace(body, reduced=replace(body.reduced, readouts={**body.reduced.readouts, trace.name: trace}))


def recorded_motion(scene: Scene, time: Array, coordinates: Mapping[str, Array], poses: Mapping[str, Pose]) -> Motion:
    """Make the motion of a modelled scene, which is `traced`, from recorded coordinates and poses.

    Args:
        scene: the scene as modelled, see `Assembly.scene`.
        time: times, (n,) [s].
        coordinates: coordinates of the modelled bodies, by name, (n, n_own) each; for a rigid body the motion of its
            centre of mass along the world's axes. Bodies without an entry do not deform.
        poses: poses of bodies whose frames move, by name; the frames of other bodies stay at rest, except rigid bodies
            with coordinates.

    Returns:
        The motion.
    """
    places, rotations, originals = {}, {}, {}
    for body in scene.bodies:
        own = coordinates.get(body.name)
        if body.name in poses:
            places[body.name], rotations[body.name] = poses[body.name]
        else:
            places[body.name] = np.broadcast_to(body.position, (len(time), 3))
            rotations[body.name] = np.broadcast_to(body.rotation, (len(time), 3, 3))
            if isinstance(body, RigidBody) and own is not None:
                places[body.name] = body.position + own[:, :3]
                rotations[body.name] = Rotation.from_rotvec(own[:, 3:]).as_matrix() @ body.rotation
        if isinstance(body, FlexibleBody):
            rows = _rows(body)
            originals[body.name] = np.zeros((len(time), len(rows))) if own is None else own @ rows.T
    return Motion(time, places, rotations, originals)


def scene_modes(scene: Scene, *, n: int | None = None) -> tuple[Array, dict[str, Array]]:
    """Compute a scene's first n undamped modes of small motion, with unit modal mass.

    They are those of the reference configuration, without the stiffness that gravity and spin add;
    `nassim.simulation.mode_motion` has those about the equilibrium.

    Args:
        scene: the scene.
        n: number of modes, at least 1; default: all.

    Returns:
        Frequencies, (m,) [Hz], ascending, 0 for rigid-body modes only; and the motion of the bodies that move, by name:
            coordinates of `FlexibleBody.reduced`, for any trimming, or for a rigid body the motion of its centre of
            mass along the world's axes, (n_coordinates, m) each.
    """
    n = None if n is None else whole_number("n", n, 1)
    assembly = assemble(traced(scene))
    return assembly.modal.frequency[:n], original_coordinates(assembly, assembly.modal.modes[:, :n])


def original_coordinates(assembly: Assembly, shapes: Array) -> dict[str, Array]:
    """Split motions of an assembled scene, which is `traced`, by bodies.

    Args:
        assembly: the assembled scene.
        shapes: motions in all coordinates, (n_all, m).

    Returns:
        By the name of each body that moves, coordinates of the original reduced body, or for a rigid body the motion of
        its centre of mass along the world's axes, (n_coordinates, m).
    """
    own = {name: shapes[place] for name, place in assembly.coordinates.slices.items()}
    for body in assembly.scene.flexible_bodies:
        own[body.name] = _rows(body) @ own[body.name]
    return own


def _rows(body: FlexibleBody) -> Array:
    """Return the coordinates of the original body per unit of a trimmed body's own."""
    (trace,) = readouts_of(body.reduced.readouts, Trace)
    return trace.rows
