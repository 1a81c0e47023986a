"""Checks before a run in time: whether method, options, loops and drives fit each other and the scene."""

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from nassim.base.checks import Array, finite, known
from nassim.scene.scene import Scene, recorded
from nassim.scene.terms import BaseAcceleration, Feedthrough, Output, PrescribedMotion
from nassim.simulation.linear.linearization import linear_model
from nassim.simulation.loaded.first_order_equilibrium import NOT_SMALL
from nassim.simulation.model.assembly import assemble
from nassim.simulation.model.capabilities import EXACT, check_capabilities
from nassim.simulation.model.digital_controllers import samples_per_period
from nassim.systems.linear_model import LinearModel
from nassim.systems.python_controller import PythonController

STARTS = ("equilibrium", "released")
STABLE_ANGLE = 2.6
"""Phase angle of a mode per step [rad] up to which the Runge-Kutta rule of order 4 is stable at any damping."""


def check_options(method: str, spectral_radius: float | None, hold_order: int | None) -> None:
    """Check the options of a method.

    Args:
        method: name of the method.
        spectral_radius: of generalized-alpha [-]; None where it is not given.
        hold_order: 0 or 1; None where it is not given.

    Raises:
        ValueError: for values out of range, and for options that the method does not have.
    """
    if spectral_radius is not None:
        if not 0.0 <= spectral_radius <= 1.0:
            raise ValueError(f"spectral_radius must lie in 0 ... 1, got {spectral_radius:g}")
        if method != "generalized_alpha":
            raise ValueError(f'spectral_radius is of "generalized_alpha"; method {method!r} has none, leave it out')
    if hold_order is not None:
        if hold_order not in (0, 1):
            raise ValueError(f"hold_order must be 0 or 1, got {hold_order!r}")
        if method == "generalized_alpha" and hold_order == 0:
            raise ValueError(
                'generalized_alpha takes inputs as straight between time steps; hold_order=0 needs "exact"'
            )
        if method == "explicit" and hold_order == 1:
            raise ValueError('"explicit" holds inputs from step to step; hold_order=1 needs another method')


def check_constant_inputs(scene: Scene, given: Mapping[str, float] | None) -> dict[str, float]:
    """Check constant values of inputs that load the start of a run.

    Args:
        scene: the scene.
        given: values by name of the input; None for none.

    Returns:
        The values by name.

    Raises:
        ValueError: for unknown inputs, values that are not finite, inputs that only loops read, and those that move a
            drive or the base.
    """
    constant = {
        known("input", name, scene.inputs): finite(f"constant input {name!r}", value)
        for name, value in (given or {}).items()
    }
    for name in constant.keys() & scene.read_by_loops.keys():
        raise ValueError(
            f"input {name!r} is a reference or noise of a loop, which is no load: a loop takes its first sample at the "
            "start; give it in the excitation"
        )
    moving = [t.input for t in scene.terms if isinstance(t, (PrescribedMotion, BaseAcceleration))]
    for name in constant:
        if name in moving:
            raise ValueError(
                f"input {name!r} moves a drive or the base, which is no load of a start: give forces and voltages; "
                "a constant acceleration of the base is a gravity of the scene"
            )
    return constant


def check_loops(scene: Scene, time_step: float) -> None:
    """Check the loops of a scene.

    Args:
        scene: the scene.
        time_step: [s].

    Raises:
        ValueError: for a sample period that is no whole number of steps, and for a loop that measures an output with
            direct feedthrough from an input that it drives.
    """
    for loop in scene.loops:
        samples_per_period(loop, time_step)
    accelerations = any(output.derivative == 2 for output in scene.terms_of(Output))
    at_once = accelerations or bool(scene.prescribed) or bool(scene.terms_of(Feedthrough))
    if not scene.loops or not at_once:
        return
    model = _model_of_loops(scene)
    for loop in scene.loops:
        rows, columns = map(model.outputs.index, loop.measured), list(map(model.inputs.index, loop.driven))
        for row in rows:
            if np.any(model.D[row, columns]):
                raise ValueError(
                    f"loop {loop.name!r} measures {model.outputs[row]!r}, which follows what the loop drives at once, "
                    "so whether a sample sees its command is open: give the sensor, amplifier or drive a bandwidth"
                )


def _model_of_loops(scene: Scene) -> LinearModel:
    """Return the model at rest of what loops measure, where only drives move that follow a loop's commands."""
    measured = {name for loop in scene.loops for name in loop.measured}
    sensors = [s for s in scene.sensors if any(term.name in measured for term in recorded(s.terms(scene)))]
    assembly = assemble(replace(scene, sensors=sensors, loops=()))
    commanded = {assembly.scene.inputs.index(name) for name in scene.commanded_inputs}
    prescribed = assembly.signals.prescribed
    moving = prescribed.chosen([k for k, index in enumerate(prescribed.inputs) if index in commanded])
    return linear_model(replace(assembly, signals=replace(assembly.signals, prescribed=moving)))


def check_drives(scene: Scene, signals: Mapping[str, Array]) -> None:
    """Check that the inputs of prescribed motions start at zero, the reference configuration.

    Args:
        scene: the scene.
        signals: values of the inputs by name, shape (n,) each.

    Raises:
        ValueError: for an input that starts elsewhere.
    """
    for drive in scene.prescribed:
        if signals[drive.input][0]:
            raise ValueError(
                f"input {drive.input!r} prescribes the motion of joint {drive.constraint!r} from the reference "
                f"configuration: it must start at 0, not at {signals[drive.input][0]:g} {drive.unit}; subtract its "
                "first value"
            )


def turning_drives(scene: Scene) -> list[tuple[int, PrescribedMotion]]:
    """Return the drives that follow inputs and turn joints, with their indices among those that follow inputs."""
    return [
        (k, drive)
        for k, drive in enumerate(scene.prescribed)
        if scene.constraints[drive.constraint].measure.rotation_axis(drive.component) is not None
    ]


def check_steps_of_drives(scene: Scene, drives: Iterable[PrescribedMotion], values: Array) -> None:
    """Check that drives without a known path turn joints little, as exact steps about the start need.

    Args:
        scene: the scene.
        drives: the drives.
        values: present angles of their joints, (drives,) [rad].

    Raises:
        ValueError: for a drive that turns its joint far.
    """
    for drive, angle in zip(drives, values.tolist(), strict=True):
        if abs(angle) > NOT_SMALL:
            raise ValueError(
                f'method "exact", scene {scene.name!r}: input {drive.input!r} would turn joint {drive.constraint!r} by '
                f"{angle:.3g} rad, which is no small motion (up to {NOT_SMALL:g} rad) about the start: give the run "
                "its course as path= if it is the only drive that turns far, or take generalized_alpha"
            )


def path_drive(scene: Scene, signals: Mapping[str, Array]) -> int | None:
    """Find the drive that turns a joint along a path, about which exact steps are: far, or with bodies that float.

    Args:
        scene: the scene.
        signals: values of the inputs by name, shape (n,) each.

    Returns:
        Its index among the drives that follow inputs; None where there is no such drive.

    Raises:
        ValueError: for several drives that turn joints far, for one beside a drive of constant speed, and for one whose
            path a loop or a servo makes.
    """
    turning = [(k, drive, float(np.abs(signals[drive.input]).max())) for k, drive in turning_drives(scene)]
    floating = bool(scene.of_fidelity("ffrf"))
    far = [drive for _, drive, angle in turning if angle > NOT_SMALL]
    alone = floating and not far and not scene.speeds  # also a small turn, of floating bodies without a servo
    found = [k for k, drive, angle in turning if drive in far or (alone and angle and np.isinf(drive.bandwidth))]
    if not found:
        return None
    where, drive = f'method "exact", scene {scene.name!r}', scene.prescribed[found[0]]
    if len(found) > 1 or scene.speeds:
        others = [one.input or f"constant speed of {one.constraint}" for one in (*far, *scene.speeds)]
        raise ValueError(
            f"{where}: small motion is about the path of one drive, and several turn joints "
            f"({', '.join(dict.fromkeys(others))}); take generalized_alpha"
        )
    if any(drive.input in loop.driven for loop in scene.loops):
        raise ValueError(
            f"{where}: a loop drives {drive.input!r}, so its path is not known before the run; take generalized_alpha"
        )
    if any(isinstance(loop.controller, PythonController) for loop in scene.loops):
        raise ValueError(
            f"{where}: exact steps along the path of {drive.input!r} need linear controllers; take generalized_alpha"
        )
    if np.isfinite(drive.bandwidth):
        raise ValueError(
            f"{where}: input {drive.input!r} turns joint {drive.constraint!r} far through a servo; give the path that "
            "the servo makes to a drive without a bandwidth, or take generalized_alpha"
        )
    return found[0]


def check_exact(scene: Scene, signals: Mapping[str, Array]) -> None:
    """Check that the exact method can simulate a scene.

    Args:
        scene: the scene.
        signals: values of the inputs by name, shape (n,) each.

    Raises:
        ValueError: for a floating-frame body in a scene that no drive turns, for a body that spins there, for drives
            that turn joints far where no sequence of models holds, and for terms that exact steps refuse.
    """
    small = f'method "exact" is for small motion: in scene {scene.name!r}'
    path = path_drive(scene, signals)
    floating = [body.name for body in scene.of_fidelity("ffrf")]
    if not scene.speeds and ((floating and path is None) or scene.spinning):
        found = (
            f'body {floating[0]!r} has fidelity "ffrf"'
            if floating and path is None
            else f"body {scene.spinning[0]!r} spins without a drive of constant speed"
        )
        raise ValueError(f"{small}, {found}; take generalized_alpha")
    check_capabilities(scene, EXACT)


def check_stability(scene: Scene, time_step: float) -> None:
    """Check that the explicit rule is stable and can simulate a scene.

    Args:
        scene: the scene.
        time_step: [s].

    Raises:
        ValueError: for large motion, for circuits, prescribed motions and outputs of accelerations, and for a time
            step beyond the stability limit, which heavy dampers make shorter.
    """
    if not scene.in_small_motion:
        kinds = ", ".join(f"{body.name} {body.fidelity}" for body in scene.flexible_bodies) or "none"
        raise ValueError(
            'method "explicit" is for small motion: it needs a flexible body of fidelity "linear" and none of "ffrf", '
            f"nor one that spins; the scene has: {kinds}"
        )
    assembly = assemble(scene)
    if assembly.signals.circuits:
        raise ValueError(
            'method "explicit" cannot integrate the circuits of coils and of sensors with a resistance; take another'
        )
    if assembly.signals.prescribed.inputs:
        raise ValueError('method "explicit" cannot let joints follow inputs; take another, or let a force act there')
    accelerations = [term.name for term in scene.terms_of(Output) if term.derivative == 2]
    if accelerations:
        raise ValueError(
            f'method "explicit" has the accelerations before an input changes, so output {accelerations[0]!r} would '
            "miss what the input does at once: take another method, or leave the sensor out"
        )
    modal = assembly.modal
    stiffness = np.diag(modal.omega**2)
    motion = np.block([[0 * stiffness, np.eye(len(stiffness))], [-stiffness, -modal.damping.of_modes]])
    fastest = float(np.abs(np.linalg.eigvals(motion)).max()) / (2 * np.pi)  # heavy dampers have poles beyond all modes
    limit = STABLE_ANGLE / (2 * np.pi * fastest)
    if time_step > limit:
        raise ValueError(
            f"time_step {time_step:g} s is beyond the explicit rule's limit of {limit:.3g} s, set by the fastest pole "
            f"of {fastest:.4g} Hz: take a shorter one, a cutoff_frequency, or an implicit or the exact method"
        )
