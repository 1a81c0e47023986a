"""Geometric stiffness of a reduced body: the stiffness that its own stress adds to small motion under load.

A body at rest under loads has a stress that is linear in a few amplitudes: the motions of its remote points, the body
force on its material, and the voltages of its electrical ports. The body force per mass of gravity, of a linear or
angular acceleration and of every spin is affine in the position, b = field @ (1, x, y, z), which has twelve amplitudes.
With the displacement u_k of a unit case k, its stress sigma_k and the displacement psi_j of coordinate j,

    K_k[i, j] = int sigma_k : (grad psi_i^T grad psi_j) dV
    T_k[i, j] = K_k[i, j] + int sigma_i : (grad u_k^T grad psi_j) dV + int sigma_j : (grad u_k^T grad psi_i) dV

T_k is the third derivative of the strain energy of a St. Venant-Kirchhoff material. Its first part is the stress
stiffness, the two others are the change of shape, which matters as much in bent parts. The tangent stiffness under load
is K + sum_k amplitude_k T_k, of first order in the loads. The stress in it is exact with any number of modes.

A scene moves its bodies by frames, whose rotations are large. There T acts on the deformation relative to the frame.
Source: T. Belytschko, W. K. Liu, B. Moran, Nonlinear Finite Elements for Continua and Structures (2000), ch. 6;
A. A. Shabana, Dynamics of Multibody Systems, 4th ed. (2013), on geometric stiffness in floating frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.short_repr import short_repr

STRESS_STIFFNESS = "stress stiffness"
"""Name of the geometric stiffness among a body's read-outs."""
BODY_FORCES = 12
"""Number of unit cases of body forces that are affine in the position."""


@dataclass(frozen=True)
class StressStiffness:
    """Geometric stiffness of a body per unit of what stresses it.

    The m unit cases are motions of remote points, then twelve body forces, then voltages of electrical ports. The
    cases of body forces and voltages have all remote points of the finite element model held.

    Attributes:
        rows: amplitudes of the cases per unit of the body's n coordinates, shape (m, n)
        matrices: geometric stiffness per unit amplitude, each symmetric, shape (m, n, n)
        ports: names of the electrical ports, the last cases
    """

    rows: Array
    matrices: Array
    ports: tuple[str, ...] = ()
    __repr__ = short_repr

    def __post_init__(self) -> None:
        rows = finite_array("stress stiffness: rows", self.rows, (None, None))
        m, n = rows.shape
        ports = unique("stress stiffness: electrical port", self.ports)
        if m < BODY_FORCES + len(ports):
            raise ValueError(
                f"stress stiffness: {m} cases are too few for {BODY_FORCES} body forces and {len(ports)} ports"
            )
        freeze(
            self, rows=rows, matrices=finite_array("stress stiffness: matrices", self.matrices, (m, n, n)), ports=ports
        )

    @property
    def name(self) -> str:
        """Always "stress stiffness", because a body has one."""
        return STRESS_STIFFNESS

    @property
    def n_coordinates(self) -> int:
        """Number n of the body's coordinates."""
        return self.rows.shape[1]

    def projected(self, change: Array) -> "StressStiffness":
        """Return the geometric stiffness for n' coordinates q', where q = change @ q', shape (n, n')."""
        matrices = change.T @ self.matrices @ change
        return replace(self, rows=self.rows @ change, matrices=0.5 * (matrices + matrices.transpose(0, 2, 1)))

    def with_voltage_rows(self, rows: Mapping[str, Array]) -> "StressStiffness":
        """Return the geometric stiffness of a body whose ports have voltages that follow its coordinates.

        Args:
            rows: name of a port -> its voltage per unit of the coordinates, shape (n,) [V]; it adds to that of earlier
                calls. Ports without a case are ignored.
        """
        changed = self.rows.copy()
        for port in rows:
            if port in self.ports:
                changed[self._case(port)] += rows[port]
        return replace(self, rows=changed)

    def with_responses(self, responses: Array) -> "StressStiffness":
        """Return the geometric stiffness where body forces also move the coordinates.

        Args:
            responses: coordinates per unit of the body forces, shape (n, 12), which coordinates given to `stiffness`
                do not include
        """
        first = len(self.rows) - len(self.ports) - BODY_FORCES
        changed = self.matrices.copy()
        changed[first : first + BODY_FORCES] += np.tensordot((self.rows @ responses).T, self.matrices, axes=1)
        return replace(self, matrices=changed)

    def stiffness(
        self, coordinates: Array, body_force: Array | None = None, voltages: Mapping[str, float] | None = None
    ) -> Array:
        """Compute the geometric stiffness under loads, to be added to the stiffness matrix.

        Args:
            coordinates: coordinates of the body at rest under all of the loads, shape (n,)
            body_force: body force per mass as coefficients of 1, x, y, z in the body's frame, shape (3, 4) [m/s2,
                1/s2]; gravity g is the first column
            voltages: voltages that are applied to electrical ports [V]; others are zero, or follow the coordinates

        Returns:
            Geometric stiffness, symmetric, shape (n, n).

        Raises:
            ValueError: for an unknown port and for arrays of other shapes
        """
        amplitudes = self.rows @ finite_array("coordinates", coordinates, (self.n_coordinates,))
        if body_force is not None:
            first = len(amplitudes) - len(self.ports) - BODY_FORCES
            amplitudes[first : first + BODY_FORCES] += finite_array("body_force", body_force, (3, 4)).T.ravel()
        for port, voltage in (voltages or {}).items():
            amplitudes[self._case(known("electrical port", port, self.ports))] += voltage
        result: Array = np.tensordot(amplitudes, self.matrices, axes=1)
        return result

    def _case(self, port: str) -> int:
        """Return the index of a port's case."""
        return len(self.rows) - len(self.ports) + self.ports.index(port)
