"""Exudyn's items of the usual construction of the bench: the flexible body on its faces' nodes, the guided mass."""

from collections.abc import Mapping
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np
from exudyn.rigidBodyUtilities import GetRigidBodyNode

from nassim import RigidBody, Scene
from nassim.simulation import assemble

Faces = Mapping[str, np.ndarray]
"""Nodes of the skin by remote point."""


def add_flexible_body(mbs: Any, scene: Scene, faces: Faces) -> dict[str, int]:
    """Add the scene's flexible body in a floating frame; returns a marker per face, at the mean of its nodes."""
    assembly, body = assemble(scene), scene.flexible_bodies[0]
    frame, reduced = assembly.frames[body.name], body.reduced
    assert reduced.surface is not None
    assert reduced.surface_modes is not None
    chosen = np.concatenate(list(faces.values()))
    rows = reduced.surface_modes[chosen][:, :, frame.flexible].reshape(3 * len(chosen), -1)
    zero = [0.0] * rows.shape[1]
    node = mbs.AddNode(GetRigidBodyNode(exu.NodeType.RotationEulerParameters, position=list(frame.origin)))
    modes = mbs.AddNode(
        eii.NodeGenericODE2(
            numberOfODE2Coordinates=len(zero),
            referenceCoordinates=zero,
            initialCoordinates=zero,
            initialCoordinates_t=zero,
        )
    )
    number = mbs.AddObject(
        eii.ObjectFFRFreducedOrder(
            nodeNumbers=[node, modes],
            mass=frame.mass,
            inertia=frame.inertia,
            centerOfMass=frame.center_of_mass,
            massMatrixReduced=container_of(frame.mass_matrix),
            stiffnessMatrixReduced=container_of(frame.stiffness_matrix),
            dampingMatrixReduced=container_of(assembly.damping.on_deformation()),
            mPhitTPsi=frame.translation_flexible,
            mPhitTPsiTilde=frame.translation_rotated,
            mXRefTildePsi=frame.position_flexible,
            mXRefTildePsiTilde=frame.position_rotated,
            mPsiTildePsi=frame.rotated_flexible,
            mPsiTildePsiTilde=frame.rotated_rotated,
            modeBasis=rows,
            referencePositions=(reduced.surface.points[chosen] - frame.origin).ravel(),
        )
    )
    markers, start = {}, 0
    for name, face in faces.items():
        kind = eii.MarkerSuperElementRigid if name in ("bottom", "top") else eii.MarkerSuperElementPosition
        nodes, weights = list(range(start, start + len(face))), [1 / len(face)] * len(face)
        markers[name] = mbs.AddMarker(kind(bodyNumber=number, meshNodeNumbers=nodes, weightingFactors=weights))
        start += len(face)
    return markers


def add_guided_mass(
    mbs: Any, payload: RigidBody, markers: Mapping[str, int], bottom: np.ndarray, top: np.ndarray
) -> int:
    """Clamp the body's bottom to the ground and guide a payload on its top along z; returns the payload's object."""
    ground = mbs.AddObject(eii.ObjectGround())
    feet = [mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=ground, localPosition=list(p))) for p in (bottom, top)]
    node = mbs.AddNode(eii.NodeRigidBodyEP(referenceCoordinates=[*payload.position, 1.0, 0.0, 0.0, 0.0]))
    j = np.diag(np.asarray(payload.inertia))
    mass = mbs.AddObject(eii.ObjectRigidBody(nodeNumber=node, mass=payload.mass, inertia=[*j, 0.0, 0.0, 0.0]))
    below = mbs.AddMarker(eii.MarkerBodyRigid(bodyNumber=mass, localPosition=list(top - payload.position)))
    for pair, axes in (
        ([feet[0], markers["bottom"]], [1] * 6),
        ([markers["top"], below], [1] * 6),
        ([feet[1], below], [1, 1, 0, 1, 1, 1]),
    ):
        mbs.AddObject(eii.ObjectJointGeneric(markerNumbers=pair, constrainedAxes=axes))
    return mass


def container_of(matrix: Any) -> Any:
    """A dense matrix as Exudyn takes it."""
    result = exu.MatrixContainer()
    result.SetWithDenseMatrix(matrix, useDenseMatrix=True)
    return result
