"""The Exudyn system of a scene in small motion."""

from collections.abc import Mapping
from typing import Any

import exudyn as exu
import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.simulation.compensation import Steps
from nassim.simulation.exudyn.state import COORDINATES, Carrier, Push, System, Term, add_circuit, add_forces, modal_node
from nassim.simulation.following import product
from nassim.simulation.small_motion import Assembly


def small_motion_system(assembly: Assembly, rates: Mapping[str, float], steps: Steps | None) -> System:
    """The system of a scene in small motion: one object in modal coordinates, so joints need no multipliers.

    What the modes do not share is zero, so a step takes time in proportion to their number.

    With drives that follow inputs the amplitudes are a of `nassim.simulation.following`, and the motions of the drives
    are coordinates too.

    rates: of these inputs at the start; steps: whose error in periods is made up for
    """
    scene = assembly.scene
    container = exu.SystemContainer()
    mbs = container.AddSystem()
    n, modes = len(assembly.frequency), assembly.basis @ assembly.shapes
    mass, growth = steps.factors(assembly.frequency) if steps else np.ones((2, n))
    forces = modes.T @ assembly.input_matrix
    node = mbs.AddNode(modal_node(n))
    mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node],
            massMatrix=_sparse(np.diag(mass)),
            stiffnessMatrix=_sparse(np.diag((2 * np.pi * assembly.frequency) ** 2)),
            dampingMatrix=_sparse(np.sqrt(growth)[:, None] * assembly.damping.of_modes * np.sqrt(growth)),
            forceVector=modes.T @ assembly.weight,
        )
    )
    followed, drives, massless = _add_drives(mbs, assembly, node, rates)
    nodes = (node, *followed)
    motion = np.hstack([modes, assembly.following.beyond])
    drives += [Push(add_forces(mbs, [node], n), name, forces[:, k]) for k, name in enumerate(scene.inputs)]
    for a in assembly.amplifiers:
        drives.append(Push(add_forces(mbs, [node], n), scene.inputs[a.input], modes.T @ a.forces, rate=a.rate))
    readings: dict[str, list[Term]] = {name: [] for name in scene.outputs}
    rows = (assembly.output_matrix, assembly.velocity_matrix, assembly.acceleration_matrix)
    for kind, weights in zip(COORDINATES, rows, strict=True):
        for name, row in zip(scene.outputs, product(weights, motion), strict=True):
            for number, share in zip(nodes, np.split(row, [n]), strict=False):
                if np.any(share):
                    sensor = eii.SensorNode(
                        nodeNumber=number, outputVariableType=kind, storeInternal=True, writeToFile=False
                    )
                    readings[name].append(Term.linear(mbs.AddSensor(sensor), share))
    for circuit in assembly.circuits:
        number, reading = add_circuit(mbs, circuit, nodes, motion.T @ circuit.forces, driven=len(motion.T) - n)
        massless.append(number)
        readings[circuit.output].append(reading)
    bodies = [body for body in scene.bodies if body.name in assembly.slices]
    counts = tuple(zip(nodes, (n, len(motion.T) - n), strict=False))
    carriers = {body.name: Carrier(counts, motion[assembly.slices[body.name]]) for body in bodies}
    mbs.Assemble()
    return System(container, mbs, assembly, {}, carriers, tuple(drives), readings, tuple(massless))


def _add_drives(
    mbs: Any, assembly: Assembly, node: int, rates: Mapping[str, float]
) -> tuple[list[int], list[Push], list[int]]:
    """Add the motions of drives that follow inputs, d of them; the node, what sets them, the object; nothing without.

    Massless rows k u = k input, beside what u and u' push in the modes.
    """
    following, (n, d) = assembly.following, assembly.following.momentum.shape
    if not d:
        return [], [], []
    push = (2 * np.pi * assembly.frequency[:, None]) ** 2 * following.momentum
    slip = assembly.damping.of_modes @ following.momentum - following.drag
    # As large as the forces that they stand beside, else the tolerance of Newton's iterations passes over them.
    sizes = np.maximum(np.linalg.norm(push, axis=0), 1.0)
    mass, stiffness, damping = np.zeros((3, n + d, n + d))
    mass[n:, n:] = np.diag(sizes)
    stiffness[:n, n:], stiffness[n:, n:], damping[:n, n:] = -push, np.diag(sizes), -slip
    names = [assembly.scene.inputs[index] for index in following.inputs]
    direct = np.isinf(following.rates)
    speeds = [rates.get(name, 0.0) * at_once for name, at_once in zip(names, direct, strict=True)]
    motions = mbs.AddNode(modal_node(d, speeds))
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[node, motions], massMatrix=mass, stiffnessMatrix=stiffness, dampingMatrix=damping
        )
    )
    pushes = [
        Push(add_forces(mbs, [motions], d), name, sizes[k] * np.eye(d)[k], rate=following.rates[k])
        for k, name in enumerate(names)
    ]
    return [motions], pushes, [number]


def _sparse(matrix: Array) -> Any:
    result: Any = exu.MatrixContainer()
    rows, columns = np.nonzero(matrix)
    entries = np.column_stack([rows, columns, matrix[rows, columns]])
    result.SetWithSparseMatrix(entries, *matrix.shape, useDenseMatrix=False)
    return result
