"""The linear model of a scene: small motion about its start, in minimal coordinates."""

from dataclasses import dataclass, replace

import numpy as np

from nassim.assembly import assemble, state_space
from nassim.checks import Array, finite_array, freeze
from nassim.frf import FRF
from nassim.parts import Body, FlexibleBody
from nassim.scene import Scene

WELL_CONDITIONED = 1e8


@dataclass(frozen=True)
class LinearModel:
    """State space dx/dt = A x + B u, y = C x + D u with named inputs and outputs.

    A: (n, n); B: (n, inputs); C: (outputs, n); D: (outputs, inputs)
    units: of the outputs
    """

    A: Array
    B: Array
    C: Array
    D: Array
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    units: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        n, n_in, n_out = len(self.A), len(self.inputs), len(self.outputs)
        freeze(
            self,
            A=finite_array("A", self.A, (n, n)),
            B=finite_array("B", self.B, (n, n_in)),
            C=finite_array("C", self.C, (n_out, n)),
            D=finite_array("D", self.D, (n_out, n_in)),
        )

    def poles(self) -> Array:
        """Eigenvalues of A, complex, shape (n,) [rad/s]."""
        result: Array = np.linalg.eigvals(self.A)
        return result


def linearize(scene: Scene) -> LinearModel:
    """The scene's linear model about its start, with the modal damping that the scene states.

    The states are the minimal coordinates' modal amplitudes and their rates, then the charges of ports that leak (as
    volts) and the outputs of amplifiers with a bandwidth. The scene's loops are open. Gravity's effect on stiffness and
    gyroscopic terms of a spinning body are not part of it.
    """
    state, drives, readings = state_space(assemble(scene))
    feedthrough = np.zeros((len(scene.outputs), len(scene.inputs)))
    units = tuple(sensor.unit for sensor in scene.sensors)
    return LinearModel(state, drives[:, :-1], readings, feedthrough, scene.inputs, scene.outputs, units)


def frequency_response(model: LinearModel, frequency: Array, *, label: str = "linear model") -> FRF:
    """FRF of a linear model at the given frequencies, shape (n,) [Hz].

    By the eigenvectors of A, which costs milliseconds; where they do not span (a double pole at one place, as of rigid
    motion without damping) by a solve per frequency.
    """
    frequency = finite_array("frequency", frequency, (None,))
    s = 2j * np.pi * frequency
    if not len(model.A):
        nothing = np.broadcast_to(model.D[:, :, None], (*model.D.shape, len(frequency))).astype(complex)
        return FRF(frequency, nothing, model.outputs, model.inputs, None, label)
    poles, vectors = np.linalg.eig(model.A)
    if np.linalg.cond(vectors / np.linalg.norm(vectors, axis=0)) < WELL_CONDITIONED:
        inputs = np.linalg.solve(vectors, model.B.astype(complex))
        values = np.einsum("ok,ki,kf->oif", model.C @ vectors, inputs, 1.0 / (s - poles[:, None])) + model.D[:, :, None]
    else:
        resolvent = s[:, None, None] * np.eye(len(model.A)) - model.A
        states = np.linalg.solve(resolvent, np.broadcast_to(model.B, (len(frequency), *model.B.shape)))
        values = (model.C @ states + model.D).transpose(1, 2, 0)
    return FRF(frequency, values, model.outputs, model.inputs, None, label)


def truncation_error(scene: Scene, frequency: Array) -> Array:
    """Estimated relative error of a scene's FRFs due to the modes that its flexible bodies leave out.

    frequency: (n,) [Hz]. Returns |H / H_enriched - 1|, shape (outputs, inputs, n) [-], where H_enriched is the FRF of
    the scene with every body in its `enriched` form. Raises ValueError where a body has none.
    """
    bodies: list[Body] = []
    for body in scene.bodies:
        if isinstance(body, FlexibleBody):
            if body.reduced.enriched is None:
                raise ValueError(f"body {body.name!r} carries no enriched form, so its truncation error is unknown")
            bodies.append(replace(body, reduced=body.reduced.enriched))
        else:
            bodies.append(body)
    better = frequency_response(
        linearize(replace(scene, bodies=tuple(bodies), cutoff_frequency=None)), frequency
    ).values
    result: Array = np.abs(frequency_response(linearize(scene), frequency).values / better - 1)
    return result
