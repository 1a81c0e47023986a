"""Warnings of runs in time: large motion, changed modes, distant equilibria, spin, drift and ringing."""

from collections.abc import Collection, Mapping

import numpy as np

from nassim.base.checks import Array
from nassim.base.warning_log import warn
from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.scene.terms import Output, OutputFilter, PrescribedMotion, SpringForce
from nassim.simulation.exudyn.frame_poses import FramePoses
from nassim.simulation.exudyn.running_system import System
from nassim.simulation.loaded.spinning import STIFFENING, stiffening
from nassim.simulation.model.assembly import Assembly
from nassim.simulation.model.damping import damps
from nassim.simulation.model.frame_dependence import frame_dependence
from nassim.simulation.model.motion_size import SMALL_MOTION
from nassim.simulation.model.period_correction import Steps

RINGING = 0.8
"""Spectral radius above which accelerations in large motion may ring, the default where an output reads them."""
STILL = 1e-6
"""Rate [Hz] below which nothing spins: a turn in eleven days."""
LOW_PASS = 0.1
"""Corner frequency of a low-pass over the rate of the steps, below which 4 % or less of such ringing pass."""
JOLTED = 0.05
"""Ringing of a drive's velocity over its largest value above which a warning is given."""
ROUNDED = 1000 * np.finfo(float).eps
"""Change of a path in a step, over the path's largest value, up to which rounding may be all of it."""
FELT = 0.1
"""Centrifugal acceleration above which a warning tells that it is left out: a hundredth of a weight [m/s2]."""
FRAME_DEPENDENCE = 0.01
"""Difference of strains by two frames of a body, over the strain, above which a warning is given."""
FAR = 0.1
"""Rotation [rad], or displacement over size, from the reference configuration above which a warning is given. Damping
ratios of modes in the reference configuration are then wrong by some 3 % in an elbow of two bars."""


def warn_of_motion(assembly: Assembly, largest: Mapping[str, Array]) -> None:
    """Warn of motion beyond the range of small motion or of reduced bodies.

    Args:
        assembly: the assembled scene.
        largest: largest size of motion of each body, see `motion_sizes`, (2,) [rad, -], by name.
    """
    floating = {body.name for body in assembly.scene.of_fidelity("ffrf")}
    turned = {name: float(size[0]) for name, size in largest.items() if size[0] > SMALL_MOTION and name not in floating}
    if turned:
        farthest = max(turned, key=lambda name: turned[name])
        others = f", and {len(turned) - 1} more turned far" * (len(turned) > 1)
        warn(
            f"body {farthest!r} turned by up to {turned[farthest]:.2g} rad, where small motion is wrong by some "
            f"{50 * turned[farthest] ** 2:.2g} % of the arms of its points, and forces in springs and joints that are "
            f'stiff along such arms by far more{others}: give flexible bodies fidelity "ffrf", or compare with '
            'method="generalized_alpha" where all bodies are rigid'
        )
    for name, (rotation, deformation) in largest.items():
        if max(deformation, rotation * (name in floating)) > SMALL_MOTION:
            warn(
                f"body {name!r} is deformed by up to {100 * deformation:.2g} % of its size and {rotation:.2g} rad, the "
                "most by which its points move and turn beside its rigid-body motion. A reduced body is linear: what "
                "it leaves out, such as the shortening of a leaf spring that bends, is of the order of the square of "
                "these figures. Check loads and units; if the motion is meant, cut the body where it bends into "
                'several of fidelity "ffrf", each of which deforms less'
            )


def warn_of_frames(assembly: Assembly, deformed: Mapping[str, Array]) -> None:
    """Warn of floating bodies whose strain depends on the point that carries their frame.

    Args:
        assembly: the assembled scene.
        deformed: coordinates of bodies by deformation, (n,), by name.
    """
    for name, coordinates in deformed.items():
        body = assembly.scene.body(name)
        assert isinstance(body, FlexibleBody)
        share = frame_dependence(assembly, body, coordinates)
        if share > FRAME_DEPENDENCE:
            warn(
                f"the strain of body {name!r} depends on the point that carries its frame, here "
                f"{assembly.scene.frame_point(body)!r}, by some {100 * share:.2g} %: parts of it turn against that "
                "point by so much that what the scene holds there bears forces of the second order, which may be far "
                'more than what it bears otherwise. Cut the body where it bends into several of fidelity "ffrf", or '
                "compare with FlexibleBody(..., frame=...) at another of its points"
            )


def warn_of_changed_modes(assembly: Assembly, shifts: Mapping[tuple[str, str], Array]) -> None:
    """Warn of a scene that leaves the configuration in which its modes have their damping ratios.

    Args:
        assembly: the assembled scene.
        shifts: largest relative motion of every two connected bodies, (2,) [rad, m], by their names.
    """
    if not (assembly.scene.deformable_bodies and np.any(assembly.modal.damping.ratio)):
        return
    bodies = [body for body in assembly.scene.bodies if body.moves]
    places = [body.rigid_inertia[1] for body in bodies]
    for body in bodies:
        places += [body.point_position(name) for name in body.point_names]
    size = float(np.linalg.norm(np.ptp(places, axis=0)))
    for (name, other), (turn, displacement) in shifts.items():
        if turn > FAR or displacement > FAR * size:
            warn(
                f"body {name!r} moved by up to {turn:.2g} rad and {displacement:.2g} m as seen from {other!r}, and the "
                "scene's damping_ratio holds in the reference configuration: elsewhere its modes have other ratios. "
                "Give flexible bodies a damping_ratio of their own, which holds in every position, and the scene 0"
            )
            return


def warn_of_far_equilibrium(system: System) -> None:
    """Warn of a run that starts far from the reference configuration of its scene.

    Args:
        system: Exudyn's system in the equilibrium from which the run starts.
    """
    frames = FramePoses(system)
    name, angle = max(
        ((name, frames.rotation_angle(name)) for name in system.nodes), key=lambda item: item[1], default=("", 0.0)
    )
    if angle > FAR:
        warn(
            f"the run starts in static equilibrium, with body {name!r} turned by {angle:.2g} rad from its "
            'reference configuration; to start there, give start="released"'
        )


def warn_of_spin(scene: Scene, speeds: Mapping[str, float], told: Collection[str] = ()) -> list[str]:
    """Warn of bodies that spin so fast that centrifugal stiffening, which is left out, matters.

    Args:
        scene: the scene.
        speeds: angular speeds of the bodies [rad/s], by name.
        told: names of bodies that a warning has named before.

    Returns:
        The names of the bodies that this warning names.
    """
    found = []
    for body in scene.flexible_bodies:
        rate = speeds.get(body.name, 0.0) / (2 * np.pi)
        if body.fidelity != "ffrf" or rate < STILL or body.name in told:
            continue
        first, rise = stiffening(scene, body, rate)
        if rise > STIFFENING:
            found.append(body.name)
            warn(
                f"body {body.name!r} turns at {rate:.3g} Hz, its first frequency is {first:.4g} Hz: centrifugal "
                f"stiffening, which the run leaves out, would raise that by some {100 * rise:.2g} % or more; "
                "craig_bampton(..., geometric_stiffness=True) gives it with a drive of constant speed, or with any "
                'drive and simulate(..., stress="present")'
            )
    return found


def warn_of_linear_bodies_that_turn(scene: Scene, twists: Mapping[str, Array]) -> None:
    """Warn of bodies of fidelity "linear" that turn, as they have no centrifugal forces.

    Args:
        scene: the scene.
        twists: motion of the bodies at the start, see `initial_twists`, (6,) by name.
    """
    for body in scene.flexible_bodies:
        largest = centrifugal_acceleration(body, twists[body.name])
        if body.fidelity == "linear" and largest > FELT:
            rate = np.linalg.norm(twists[body.name][3:])
            warn(
                f'body {body.name!r} of fidelity "linear" turns at {rate:.3g} rad/s without its '
                f'centrifugal forces, up to {largest:.3g} m/s2 at its points: give it fidelity "ffrf", or take '
                'method="exact"'
            )


def centrifugal_acceleration(body: Body, twist: Array) -> float:
    """Return the largest centrifugal acceleration [m/s2] of a body's points and its centre of mass.

    Args:
        body: a body that moves.
        twist: its velocity at the world's origin, and its angular velocity, (6,).
    """
    places = [body.rigid_inertia[1], *map(body.point_position, body.point_names)]
    return max(float(np.linalg.norm(np.cross(twist[3:], twist[:3] + np.cross(twist[3:], at)))) for at in places)


def warn_of_drift(description: str) -> None:
    """Warn of a run whose velocities violate the constraints.

    Args:
        description: body, time and cause; empty for a run without such a violation.
    """
    if description:
        warn(f"{description}; do not trust what comes after that time")


def ringing_outputs(scene: Scene, time_step: float) -> list[str]:
    """Return the outputs that read accelerations, by name, without a low-pass that passes next to nothing of ringing.

    Args:
        scene: the scene.
        time_step: [s].
    """
    filtered = _low_passed(scene, time_step)
    return [term.name for term in scene.terms_of(Output) if term.derivative == 2 and term.name not in filtered]


def warn_of_ringing(scene: Scene, spectral_radius: float, time_step: float) -> None:
    """Warn of outputs that read accelerations in large motion at a spectral radius that lets them ring.

    Args:
        scene: the scene.
        spectral_radius: of generalized-alpha [-].
        time_step: [s].
    """
    read = ringing_outputs(scene, time_step)
    if read and spectral_radius > RINGING:
        warn(
            f"output {read[0]!r} reads an acceleration in large motion, which rings from step to step at "
            f"spectral_radius {spectral_radius:g} by what Newton's iterations leave; take {RINGING:g} or less"
        )


def warn_of_jolts(scene: Scene, steps: Steps, signals: Mapping[str, Array]) -> None:
    """Warn of outputs that read rates in large motion while a drive's rate jumps and lets them ring.

    The rule keeps a drive on its path; where the velocity jumps between two steps, its own then overshoots, to both
    sides of the path's in turn. Forces of dampers and velocities show this, displacements do not. Likewise where the
    acceleration jumps, as at the start of a path that begins with one: accelerations show this.

    Args:
        scene: the scene.
        steps: of generalized-alpha.
        signals: values of the inputs at the time steps by name, (n,) each.
    """
    filtered = _low_passed(scene, steps.time_step)
    read = [term.name for term in scene.terms_of(Output) if term.derivative and term.name not in filtered]
    read += [term.name for term in scene.terms_of(SpringForce) if damps(term.spring) and term.name not in filtered]
    accelerations = ringing_outputs(scene, steps.time_step)
    commanded = {name: loop for loop in scene.loops for name in loop.driven}
    for drive in scene.prescribed if read else ():
        path = signals[drive.input]
        if drive.input in commanded and _warn_of_loop(commanded[drive.input], drive, read[0]):
            return
        if np.isfinite(drive.bandwidth) or len(path) < 3:
            continue
        changes = np.diff(path) / steps.time_step
        velocities, of_rule = steps.rates(path)
        of_path = np.diff(changes) / steps.time_step
        least = ROUNDED * np.abs(path).max() / steps.time_step
        if (share := _share(velocities[1:-1] - 0.5 * (changes[1:] + changes[:-1]), changes, least)) > JOLTED:
            warn(
                f"the velocity of input {drive.input!r}, which prescribes a motion, jumps at its samples, as it runs "
                f"straight between them: what {read[0]!r} reads rings from step to step by up to {100 * share:.0f} % "
                "of that velocity, and displacements hardly do; give a smooth path at every time step, or the drive a "
                "bandwidth"
            )
            return
        if accelerations and (share := _share(of_rule[1:-1] - of_path, of_path, least / steps.time_step)) > JOLTED:
            warn(
                f"the acceleration of input {drive.input!r}, which prescribes a motion, jumps at its start or at its "
                f"samples: what {accelerations[0]!r} reads rings from step to step by up to {100 * share:.0f} % of "
                "that acceleration, and dies out the sooner the smaller spectral_radius is; begin without "
                "acceleration, on a path whose acceleration runs smoothly"
            )
            return


def _share(ringing: Array, values: Array, least: float) -> float:
    """Return the largest ringing over the largest of what rings; 0 where this is `least` or less, thus rounding."""
    largest = np.abs(values).max()
    return float(np.abs(ringing).max() / largest) if largest > least else 0.0


def _warn_of_loop(loop: Loop, drive: PrescribedMotion, output: str) -> bool:
    """Warn of a drive whose velocity jumps with the commands of a loop; whether it does."""
    moves = f"loop {loop.name!r} moves joint {drive.constraint!r} by its command {drive.input!r}"
    share = 2 * np.pi * drive.bandwidth / loop.controller.sample_rate
    if not np.isfinite(drive.bandwidth):
        warn(
            f"{moves} within one time step of each sample: what {output!r} reads then jumps by the change of the "
            "command over the time step, and rings from step to step; give the drive a bandwidth"
        )
    elif share > JOLTED:
        warn(
            f"{moves} through a bandwidth of {drive.bandwidth:g} Hz: its velocity jumps at each sample by up to "
            f"{100 * share:.0f} % of that of the command, and what {output!r} reads rings from step to step by up to "
            "as much more, which the drive does not; sample faster, or give the drive a smaller bandwidth"
        )
    return share > JOLTED


def _low_passed(scene: Scene, time_step: float) -> set[str]:
    """Return the names of outputs behind a low-pass that passes next to nothing of what rings from step to step."""
    filters = scene.terms_of(OutputFilter)
    return {f.output for f in filters if f.passes != "high" and f.frequency * time_step < LOW_PASS}
