"""Scenes of any size: a ring of struts under one plate, a chain of bodies between springs."""

import numpy as np

from models.strut import LENGTH, fe_strut
from nassim import Bushing, Encoder, PointForce, ReducedBody, RigidBody, Scene, fixed, joined, placed

RADIUS = 0.1
"""Of the ring [m]."""
CUTOFF = 600.0
"""Up to which the struts' bodies are modelled [Hz]."""


def ring(fidelity: str, apa: ReducedBody, count: int) -> Scene:
    """So many upright struts in a ring on a base, under one plate of 1 kg a strut; a force pushes the plate up."""
    angles = 2 * np.pi * np.arange(count) / count
    feet = {f"joint_{k}": (RADIUS * np.cos(t), RADIUS * np.sin(t), 0.0) for k, t in enumerate(angles)}
    height = np.array([0.0, 0.0, LENGTH])
    plate = RigidBody("plate", {**feet, "centre": np.zeros(3)}, count, 1e-2 * count * np.eye(3), height)
    legs = [placed(fe_strut(fidelity, apa=apa), f"strut_{k}", position=foot) for k, foot in enumerate(feet.values())]
    return joined(
        "ring",
        *legs,
        bodies=(RigidBody("base", feet, fixed=True), plate),
        joints=[
            joint
            for k in range(count)
            for joint in (
                fixed(f"foot_{k}", f"base.joint_{k}", f"strut_{k}/bottom.end"),
                fixed(f"head_{k}", f"strut_{k}/top.end", f"plate.joint_{k}"),
            )
        ],
        actuators=(PointForce("push", "plate.centre", "z", "force"),),
        # Damping of modes is not quite the same in every fidelity.
        damping_ratio=0.0,
        cutoff_frequency=CUTOFF,
    )


def chain(count: int) -> Scene:
    """So many bodies in a line from a base on, each held to the one before in all six motions; a force on the last."""
    ends = {"low": (0.0, 0.0, -0.05), "high": (0.0, 0.0, 0.05)}
    bodies = [RigidBody(f"body_{k}", ends, 1.0, 1e-3 * np.eye(3), (0.0, 0.0, 0.1 * k + 0.05)) for k in range(count)]
    tops = ["base.top", *(f"body_{k}.high" for k in range(count))]
    stiffness = np.array([1e7, 1e7, 1e7, 1e5, 1e5, 1e5])
    return Scene(
        "chain",
        (RigidBody("base", {"top": np.zeros(3)}, fixed=True), *bodies),
        (),
        (PointForce("push", tops[-1], "z", "force"),),
        (Encoder("height", "base.top", tops[-1], axis="z"),),
        [Bushing(f"spring_{k}", tops[k], f"body_{k}.low", stiffness) for k in range(count)],
        damping_ratio=0.01,
    )
