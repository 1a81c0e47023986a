"""How the bodies of a scene move in a run, kept at some of its steps, on the coordinates that its reduced bodies have.

What simulates may know a body by fewer coordinates than it has, see `trim_scene`; a `Trace` then tells what those mean
for the body's own.
"""

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from scipy.spatial.transform import Rotation

from nassim.base.checks import Array, finite_array
from nassim.bodies.readouts import Trace, of_kind
from nassim.scene.bodies import Body, FlexibleBody, RigidBody
from nassim.scene.motion import Motion
from nassim.scene.scene import Scene
from nassim.simulation.model.assembly import Assembly, assemble

Pose = tuple[Array, Array]
"""Of a body's own frame at n times: places (n, 3) [m], rotations to the world's axes (n, 3, 3)."""


def frame_steps(frames: int | Array, n_steps: int, time_step: float) -> Array:
    """Numbers of the steps that are nearest to the times of frames, ascending, int (n,).

    frames: how many, evenly spread from the first step to the last, or their times [s]

    Raises ValueError for fewer than 2, for more than there are steps, and for times before or after the run.
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
    """The scene with reduced bodies that remember their coordinates, however they are trimmed.

    `simulate_motion` gives motion on these: of a machine whose parts were traced, then trimmed to be fast, the motion
    of the same machine with its parts whole, which have surfaces to be looked at.
    """
    return replace(scene, bodies=tuple(map(_traced, scene.bodies)))


def _traced(body: Body) -> Body:
    if not isinstance(body, FlexibleBody) or of_kind(body.reduced.readouts, Trace):
        return body
    trace = Trace(np.eye(len(body.reduced.mass_matrix)))
    return replace(body, reduced=replace(body.reduced, readouts={**body.reduced.readouts, trace.name: trace}))


def recorded_motion(
    assembly: Assembly, time: Array, coordinates: Mapping[str, Array], poses: Mapping[str, Pose]
) -> Motion:
    """What a run of an assembled scene, which is `traced`, has kept.

    coordinates: of the modelled bodies, by name, (n, n_own) each; of a rigid one the motion of its centre of mass along
        the world's axes. Bodies without do not deform
    poses: of bodies whose frames move; those of the others stay, but for rigid ones with coordinates
    """
    places, turns, originals = {}, {}, {}
    for body in assembly.scene.bodies:
        own = coordinates.get(body.name)
        if body.name in poses:
            places[body.name], turns[body.name] = poses[body.name]
        else:
            places[body.name] = np.broadcast_to(body.position, (len(time), 3))
            turns[body.name] = np.broadcast_to(body.rotation, (len(time), 3, 3))
            if isinstance(body, RigidBody) and own is not None:
                places[body.name] = body.position + own[:, :3]
                turns[body.name] = Rotation.from_rotvec(own[:, 3:]).as_matrix() @ body.rotation
        if isinstance(body, FlexibleBody):
            rows = _rows(body)
            originals[body.name] = np.zeros((len(time), len(rows))) if own is None else own @ rows.T
    return Motion(time, places, turns, originals)


def scene_modes(scene: Scene, *, n: int | None = None) -> tuple[Array, dict[str, Array]]:
    """A scene's first n modes of small motion about its start (default: all), undamped, of unit modal mass.

    Returns their frequencies (m,) [Hz], ascending, 0 for free motions only, and what the bodies that move do, by name:
    coordinates of `FlexibleBody.reduced`, whatever is modelled of them, or of a rigid body the motion of its centre of
    mass along the world's axes, (n_coordinates, m) each.
    """
    assembly = assemble(traced(scene))
    shapes = assembly.basis @ assembly.shapes[:, :n]
    own = {body.name: shapes[assembly.slices[body.name]] for body in assembly.scene.bodies if body.moves}
    for body in assembly.scene.flexible_bodies:
        own[body.name] = _rows(body) @ own[body.name]
    return assembly.frequency[:n], own


def _rows(body: FlexibleBody) -> Array:
    """Coordinates of a body before it was trimmed per unit of its own."""
    (trace,) = of_kind(body.reduced.readouts, Trace)
    return trace.rows
