"""Prestressed scenes: the stress inside bodies at the start as a constant part of their stiffness, for runs in time."""

from collections.abc import Mapping
from dataclasses import replace

from nassim.scene.bodies import Body, FlexibleBody
from nassim.scene.scene import Scene
from nassim.simulation.linear.linearization import NO_SPIN, loaded_assembly
from nassim.simulation.model.trimming import trim_scene


def prestress_scene(scene: Scene, *, inputs: Mapping[str, float] | None = None) -> Scene:
    """Add the geometric stiffness of a scene's loads to the stiffness of its floating bodies, for runs in time.

    Runs in floating frames have the geometric stiffness of rigid bodies, joints and springs, but not that of the stress
    inside bodies. Here the stress under gravity, constant inputs and the drives of constant speed becomes a constant
    part of the stiffness matrices. It remains that of the start as the scene moves. The bodies of the result have no
    geometric stiffness that loads could add again.

    Args:
        scene: the scene; it is trimmed if it has a cut-off frequency.
        inputs: constant values of inputs, by name; others are zero.

    Returns:
        The scene with other bodies.

    Raises:
        ValueError: for a body in small motion, which would have the stress without the stiffness of weights and joints
            that belongs to it, and for loads without an equilibrium near the start.
    """
    small = [body.name for body in scene.deformable_bodies if body.fidelity != "ffrf"]
    if small:
        raise ValueError(
            f"body {small[0]!r} is in small motion, where runs leave out the stiffness of weights and joints: give it "
            'the fidelity "ffrf", or use linearize, which has all of the stiffness'
        )
    state = loaded_assembly(scene, NO_SPIN, NO_SPIN, None, "rotor", inputs=inputs).loads
    assert state is not None

    def stressed(body: Body) -> Body:
        if not isinstance(body, FlexibleBody) or body.name not in state.inside:
            return body
        added = state.inside[body.name]
        stress = body.reduced.stress_stiffness
        readouts = {name: readout for name, readout in body.reduced.readouts.items() if readout is not stress}
        stiffness = body.reduced.stiffness_matrix + 0.5 * (added + added.T)
        return replace(body, reduced=replace(body.reduced, stiffness_matrix=stiffness, readouts=readouts))

    trimmed = trim_scene(scene)
    return replace(trimmed, bodies=tuple(map(stressed, trimmed.bodies)))
