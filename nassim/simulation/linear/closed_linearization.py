"""Linear models of scenes with their loops closed."""

from collections.abc import Mapping, Sequence
from itertools import pairwise

import numpy as np

from nassim.base.checks import known, unique
from nassim.base.field_types import ArrayLike
from nassim.scene.loop import Loop
from nassim.scene.scene import Scene
from nassim.simulation.linear.folding_warning import warn_of_folding, with_common_folding
from nassim.simulation.linear.linearization import linearize
from nassim.simulation.loaded.loaded_state import NO_LOAD
from nassim.systems.controller_models import DELAY_ORDER
from nassim.systems.feedback import close_around, close_loop
from nassim.systems.linear_model import LinearModel, sampled


def linearize_closed(
    scene: Scene,
    *,
    loops: Sequence[str] | None = None,
    noise: bool = False,
    continuous: bool = False,
    delay_order: int = DELAY_ORDER,
    angular_velocity: ArrayLike = NO_LOAD,
    axis_point: ArrayLike = NO_LOAD,
    stator: Sequence[str] | None = None,
    frame: str = "rotor",
    loaded: bool = True,
    constant_inputs: Mapping[str, float] | None = None,
) -> LinearModel:
    """Compute the linear model of a scene with its loops closed.

    Limits and quantisation of the loops' converters are left out.

    The model is sampled at the loops' rate: it is exactly what a simulation without saturation gives at its samples,
    with the excitation held between them. Of several rates it is sampled at the lowest, and each must be a multiple of
    the next lower one, so faster loops act between its samples; what folds at the lowest is quasi-static for all. Only
    an output that a command moves at once, such as an acceleration, has the command of its sample in the model, and
    that of the sample before in a simulation. The sampled model warns of modes that are quasi-static in it and could
    make a loop unstable.

    Args:
        scene: the scene.
        loops: names of the loops to close (None: all); the others stay open, for design. With one loop left out,
            `nassim.systems.open_loop` of its controller is that loop while the others are closed.
        noise: whether to add inputs for the noise of the measured outputs of loops that name none themselves, see
            `nassim.systems.close_loop`.
        continuous: whether to return the continuous equivalent, with delay and hold as Pade approximations.
        delay_order: order of these approximations.
        angular_velocity: angular velocity of a scene that rotates, (3,) [rad/s], see `linearize`.
        axis_point: a point of the axis, (3,) [m].
        stator: names of the bodies of the stator, see `linearize`.
        frame: "rotor" or "stator", see `linearize`.
        loaded: whether gravity and the stress inside bodies change the stiffness, see `linearize`.
        constant_inputs: constant values of inputs that load the scene too, by name, see `linearize`.

    Returns:
        The linear model.

    Raises:
        ValueError: for a scene without loops, for an unknown loop, for one whose controller has no linear model, and,
            unless continuous, for sample rates that are not multiples of the next lower ones.
    """
    if not scene.loops:
        raise ValueError(f"scene {scene.name!r} has no loops; use linearize")
    known_loops = [loop.name for loop in scene.loops]
    wanted = known_loops if loops is None else [known("loop", n, known_loops) for n in unique("loop", loops)]
    closed = [loop for loop in scene.loops if loop.name in wanted]
    for loop in closed:
        loop.linear_controller  # noqa: B018  # refuses a controller in Python by name
    rates = sorted({loop.controller.sample_rate for loop in closed or scene.loops}, reverse=True)
    if not continuous and any(abs(a / b - round(a / b)) > 1e-9 * a / b for a, b in pairwise(rates)):
        raise ValueError(
            f"the loops of scene {scene.name!r} sample at {', '.join(f'{rate:g}' for rate in rates)} Hz, which are not "
            "multiples of each other; only the continuous model has all"
        )
    model = linearize(
        scene,
        angular_velocity=angular_velocity,
        axis_point=axis_point,
        stator=stator,
        frame=frame,
        loaded=loaded,
        constant_inputs=constant_inputs,
    )
    if continuous:
        return _with_loops(model, closed, noise, delay_order)
    warn_of_folding(model, closed)
    model = with_common_folding(model, rates)
    for rate in rates:
        model = sampled(model, rate)
        model = _with_loops(model, [loop for loop in closed if loop.controller.sample_rate == rate], noise, delay_order)
    return model


def _with_loops(model: LinearModel, loops: Sequence[Loop], noise: bool, delay_order: int) -> LinearModel:
    """Close loops one after the other; see `linearize_closed`."""
    for loop in loops:
        model = close_loop(
            model,
            loop.linear_controller,
            measured=loop.measured,
            driven=loop.driven,
            reference=loop.reference,
            delay_order=delay_order,
            noise=loop.noise or noise,
        )
        if loop.feedforward is not None:
            taken = np.eye(len(model.inputs))[[model.inputs.index(name) for name in loop.reference]]
            read = np.zeros((len(taken), len(model.A))), taken
            model = close_around(
                model,
                loop.feedforward,
                read,
                measured=loop.reference,
                driven=loop.driven,
                delay_order=delay_order,
            )
    return model
