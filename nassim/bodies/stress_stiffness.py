"""Geometric stiffness of a reduced body: the stiffness that its own stress adds to small motion under load.

A body at rest under loads has a stress that is linear in a few amplitudes: the motions of its remote points, the body
force on its material, and the voltages of its electrical ports. The body force per mass of gravity, of a linear or
angular acceleration and of every spin is affine in the position, b = field @ (1, x, y, z), which has twelve amplitudes.
With the displacement u_k of a unit case k, its stress sigma_k and the displacement psi_j of coordinate j,

    K_k[i, j] = int sigma_k : (grad psi_i^T grad psi_j) dV
    T_k[i, j] = K_k[i, j] + int sigma_i : (grad u_k^T grad psi_j) dV + int sigma_j : (grad u_k^T grad psi_i) dV

T_k is the third derivative of the strain energy of a St. Venant-Kirchhoff material. Its first part is the stress
stiffness, the two others are H_k and H_k^T of the change of shape, which matters as much in bent parts. To first order
in the loads, the tangent stiffness is K + sum_k amplitude_k T_k. The stress in it is exact with any number of modes.

The change of shape alone turns the strains, K -> (1 + K^-1 H)^T K (1 + K^-1 H), so it softens nothing: a strip that a
load bends by its own thickness is as stiff as before. The square H^T K^-1 H is therefore part of the tangent, although
it is of second order in the loads. Without it, the axial stiffness of the strip would couple to its bending, and the
stiffness would drop by the square of deflection over thickness. K^-1 in the body's own coordinates takes those strains
of the square that the coordinates can release; the others count as released.

A scene moves its bodies by frames, whose rotations are large. There the stiffness acts on the deformation relative to
the frame.
Source: T. Belytschko, W. K. Liu, B. Moran, Nonlinear Finite Elements for Continua and Structures (2000), ch. 6;
A. A. Shabana, Dynamics of Multibody Systems, 4th ed. (2013), on geometric stiffness in floating frames.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nassim.base.checks import Array, finite_array, freeze, known, unique
from nassim.base.short_repr import short_repr
from nassim.base.warning_log import warn
from nassim.bodies.strain import Strain

STRESS_STIFFNESS = "stress stiffness"
"""Name of the geometric stiffness among a body's read-outs."""
NOTHING = 1e-30
"""Share of the largest column of a stiffness matrix's root below which a column is zero, whatever its unit."""
BODY_FORCES = 12
"""Number of unit cases of body forces that are affine in the position."""


@dataclass(frozen=True)
class GeometricTerms:
    """Terms of a body's geometric stiffness under a load, linear in the load.

    Attributes:
        stress: stiffness K_s of the stress, symmetric, shape (n, n)
        shape: change of shape H, shape (n, n)
    """

    stress: Array
    shape: Array

    @property
    def first_order(self) -> Array:
        """Geometric stiffness of first order in the load, K_s + H + H^T, shape (n, n)."""
        return self.stress + self.shape + self.shape.T

    def turned_strains(self, strain: Strain) -> Array:
        """Return the weighted strains that the change of shape gives to motion, shape (p, n).

        Args:
            strain: strains of the body, whose root G of the stiffness matrix has p rows. The result S is the smallest
                with G^T S = H. Motions without strain do not matter, as H has no forces on them.
        """
        scale = _scale(strain)[:, None]
        return np.linalg.lstsq(scale * strain.root.T, scale * self.shape, rcond=None)[0]

    def strained_beside(self, strain: Strain) -> Array:
        """Return the coordinates whose strains are those by change of shape, per unit of the coordinates, (n, n)."""
        scale = _scale(strain)
        found = np.linalg.lstsq(strain.root * scale, self.turned_strains(strain), rcond=None)[0]
        return scale[:, None] * found

    def added_to(self, strain: Strain) -> Array:
        """Return what the load adds to the stiffness matrix K of a body with these strains, shape (n, n).

        This is K_s + H + H^T + H^T K^-1 H.
        """
        turned = self.turned_strains(strain)
        return self.first_order + turned.T @ turned


@dataclass(frozen=True)
class StressStiffness:
    """Geometric stiffness of a body per unit of what stresses it.

    The m unit cases are motions of remote points, then twelve body forces, then voltages of electrical ports. The
    cases of body forces and voltages have all remote points of the finite element model held.

    Attributes:
        rows: amplitudes of the cases per unit of the body's n coordinates, shape (m, n)
        stress: stress stiffness K_k per unit amplitude, each symmetric, shape (m, n, n)
        shape: change of shape H_k per unit amplitude, shape (m, n, n)
        ports: names of the electrical ports, the last cases
        blocked: the part of the stress stiffness that the voltage of each port has by itself, where nothing deforms,
            each symmetric, shape (ports, n, n); None: zero
    """

    rows: Array
    stress: Array
    shape: Array
    ports: tuple[str, ...] = ()
    blocked: Array | None = None
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
            self,
            rows=rows,
            stress=finite_array("stress stiffness: stress", self.stress, (m, n, n)),
            shape=finite_array("stress stiffness: shape", self.shape, (m, n, n)),
            ports=ports,
            blocked=finite_array(
                "stress stiffness: blocked",
                np.zeros((len(ports), n, n)) if self.blocked is None else self.blocked,
                (len(ports), n, n),
            ),
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
        stress, shape = change.T @ self.stress @ change, change.T @ self.shape @ change
        blocked = change.T @ self._blocked @ change
        symmetric = {"stress": stress, "blocked": blocked}
        halves = {name: 0.5 * (part + part.transpose(0, 2, 1)) for name, part in symmetric.items()}
        return replace(self, rows=self.rows @ change, shape=shape, **halves)

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
        moved = (self.rows @ responses).T
        stress, shape = self.stress.copy(), self.shape.copy()
        stress[first : first + BODY_FORCES] += np.tensordot(moved, self.stress, axes=1)
        shape[first : first + BODY_FORCES] += np.tensordot(moved, self.shape, axes=1)
        return replace(self, stress=stress, shape=shape)

    def stiffness(
        self, coordinates: Array, body_force: Array | None = None, voltages: Mapping[str, float] | None = None
    ) -> Array:
        """Compute the geometric stiffness of first order in the loads; arguments and errors as of `under`.

        Returns:
            Geometric stiffness, symmetric, shape (n, n).
        """
        return self.under(coordinates, body_force, voltages).first_order

    def under(
        self, coordinates: Array, body_force: Array | None = None, voltages: Mapping[str, float] | None = None
    ) -> "GeometricTerms":
        """Compute the terms of the geometric stiffness under loads.

        Args:
            coordinates: coordinates of the body at rest under all of the loads, shape (n,)
            body_force: body force per mass as coefficients of 1, x, y, z in the body's frame, shape (3, 4) [m/s2,
                1/s2]; gravity g is the first column
            voltages: voltages that are applied to electrical ports [V]; others are zero, or follow the coordinates

        Returns:
            The terms, linear in the loads.

        Raises:
            ValueError: for an unknown port and for arrays of other shapes
        """
        amplitudes = self.rows @ finite_array("coordinates", coordinates, (self.n_coordinates,))
        if body_force is not None:
            first = len(amplitudes) - len(self.ports) - BODY_FORCES
            amplitudes[first : first + BODY_FORCES] += finite_array("body_force", body_force, (3, 4)).T.ravel()
        for port, voltage in (voltages or {}).items():
            amplitudes[self._case(known("electrical port", port, self.ports))] += voltage
        return GeometricTerms(*(np.tensordot(amplitudes, part, axes=1) for part in (self.stress, self.shape)))

    def of_voltages(self, voltages: Mapping[str, float]) -> Array:
        """Return the stress stiffness of voltages at ports where nothing deforms, shape (n, n).

        Args:
            voltages: by port [V]; ports without a case are ignored
        """
        result = np.zeros((self.n_coordinates,) * 2)
        for port, voltage in voltages.items():
            if port in self.ports:
                result += voltage * self._blocked[self.ports.index(port)]
        return result

    @property
    def _blocked(self) -> Array:
        assert self.blocked is not None
        return self.blocked

    def _case(self, port: str) -> int:
        """Return the index of a port's case."""
        return len(self.rows) - len(self.ports) + self.ports.index(port)


def _scale(strain: Strain) -> Array:
    """Return factors that make the columns of a root of a stiffness matrix comparable, whatever their units, (n,)."""
    sizes = np.linalg.norm(strain.root, axis=0)
    return np.divide(1.0, sizes, out=np.zeros_like(sizes), where=sizes > NOTHING * sizes.max(initial=0.0))


def upgrade_stress(content: Mapping[str, Any]) -> dict[str, Any]:
    """Convert the fields of a `StressStiffness` from files that hold the sum of its terms, "matrices" (m, n, n).

    Args:
        content: fields by name

    Returns:
        The fields of today; all of the sum counts as stress.

    Warns:
        UserWarning: because loads that bend the body then soften it too much.
    """
    kept = dict(content)
    if "matrices" in kept:
        warn(
            "the file holds a geometric stiffness of an earlier nassim, which softens bodies too much where loads bend "
            "them: reduce the body again"
        )
        kept["stress"] = kept.pop("matrices")
        kept["shape"] = np.zeros_like(kept["stress"])
    return kept
