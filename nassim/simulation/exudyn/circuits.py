"""Charges and currents of circuits as coordinates of Exudyn."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import exudyn.itemInterface as eii
import numpy as np

from nassim.base.checks import Array
from nassim.simulation.exudyn.running_system import COORDINATES, add_node_sensor
from nassim.simulation.model.signals import Circuit


@dataclass(frozen=True)
class Charge:
    """The state of a circuit as a coordinate w = v / scale that acts on coordinates q.

    The rows are symmetric: storage (v + v' / rate) = forces @ q + input / rate. The scale makes them as large as those
    of the body's forces, else the tolerance of Newton's iterations ignores them.

    Attributes:
        push: forces on q per unit of w, (n,).
        stiffness: stiffness of w.
        damping: damping of w.
        scale: the scale, v per unit of w.
        drive: force on w per unit of the circuit's input.
    """

    push: Array
    stiffness: float
    damping: float
    scale: float
    drive: float

    @classmethod
    def of(cls, circuit: Circuit, forces: Array) -> "Charge":
        """Make the coordinate of a circuit; forces: on q per unit of v, (n,)."""
        scale = float(np.linalg.norm(forces)) / circuit.storage or 1.0
        stiffness = scale**2 * circuit.storage
        drive = scale / circuit.rate
        return cls(scale * forces, stiffness, stiffness / circuit.rate, scale, drive)


@dataclass(frozen=True)
class AddedCircuit:
    """A circuit in Exudyn's system.

    Attributes:
        number: number of its object.
        node: node of its state.
        damping: damping of its state.
        sensor: sensor of its state.
        scale: state of the `Circuit` per unit of this one.
    """

    number: int
    node: int
    damping: float
    sensor: int
    scale: float


def add_circuit(mbs: Any, circuit: Circuit, nodes: Sequence[int], forces: Array) -> AddedCircuit:
    """Add a port's charge.

    Its mass serves for the accelerations at the start; `find_accelerations` removes it.

    Args:
        mbs: Exudyn's system.
        circuit: the circuit.
        nodes: nodes of the coordinates q.
        forces: forces on q per volt, (n,).

    Returns:
        The circuit.
    """
    n, charge = len(forces), Charge.of(circuit, forces)
    node = mbs.AddNode(modal_node(1))
    mass, stiffness, damping = np.zeros((3, n + 1, n + 1))
    mass[n, n] = 1.0
    stiffness[:n, n] = stiffness[n, :n] = -charge.push
    stiffness[n, n], damping[n, n] = charge.stiffness, charge.damping
    number = mbs.AddObject(
        eii.ObjectGenericODE2(
            nodeNumbers=[*nodes, node],
            massMatrix=mass,
            stiffnessMatrix=stiffness,
            dampingMatrix=damping,
        )
    )
    return AddedCircuit(number, node, charge.damping, add_node_sensor(mbs, node, COORDINATES[0]), charge.scale)


def modal_node(n: int, speeds: Sequence[float] | None = None) -> Any:
    """Make a node of n coordinates, at rest or with initial speeds."""
    zero = [0.0] * n
    return eii.NodeGenericODE2(
        numberOfODE2Coordinates=n,
        referenceCoordinates=zero,
        initialCoordinates=zero,
        initialCoordinates_t=zero if speeds is None else list(speeds),
    )
