"""Synthesis of controllers: H-infinity, H2 and mixed sensitivity.

A plant for synthesis is a `LinearModel`. The controller u = K y reads its *measured* outputs and drives its *driven*
inputs. The other inputs are disturbances w, and the other outputs are errors z that shall be small. Sensors' noise is a
disturbance and the actuators' effort is an error: without them no best controller exists.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import scipy

from nassim.base.checks import Array, above_zero, known, positive
from nassim.base.short_repr import short_repr
from nassim.systems.interconnection import interconnect, static_gain
from nassim.systems.linear_model import LinearModel, Names, names
from nassim.systems.norms import h2_norm, hinf_norm
from nassim.systems.riccati import RANK, care, check_continuous, check_regular, regulator, scaled
from nassim.systems.state_space import balanced_system

BOUNDS = 1e-30, 1e30
"""Range of the norms that are searched, where direct feedthrough does not set the lowest one."""
FIRST_STEP = 1e3
"""Ratio of the bounds that are tried until one is kept; the last interval is halved."""
Matrices = tuple[Array, Array, Array, Array]
Norm = Callable[[LinearModel], float]


@dataclass(frozen=True)
class Synthesis:
    """Result of a synthesis.

    Attributes:
        controller: controller u = K y, from the measured to the driven signals, for positive feedback as everywhere in
            nassim. `controller_from_model` samples it.
        closed_loop: plant with the controller, from disturbances to errors.
        norm: norm of `closed_loop`, computed from the closed loop itself: H-infinity or H2 as the synthesis says.
    """

    controller: LinearModel
    closed_loop: LinearModel
    norm: float
    __repr__ = short_repr


def hinf_synthesis(plant: LinearModel, *, measured: Names, driven: Names, tolerance: float = 1e-3) -> Synthesis:
    """Compute the controller with the least H-infinity norm from disturbances to errors.

    The bound on the norm is halved between values that two Riccati equations admit and refuse.

    Args:
        plant: continuous model, as the module describes.
        measured: outputs that the controller reads.
        driven: inputs that the controller drives.
        tolerance: relative distance of the norm from the least one.

    Returns:
        Controller with as many states as the plant, closed loop and its H-infinity norm.

    Raises:
        ValueError: for a plant that the method excludes; the message names the assumption.

    Source: K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control (1996), sec. 17.1.
    """
    tolerance = above_zero("tolerance", tolerance)
    parts = _Partition.of(plant, measured, driven)

    def within(bound: float) -> Synthesis | None:
        """Return a closed loop that keeps the bound, by its own norm: Riccati solutions mislead near the least one."""
        matrices = parts.controller(bound)
        found = None if matrices is None else parts.result(matrices, lambda closed: hinf_norm(closed)[0])
        return found if found is not None and found.norm <= bound * (1 + tolerance) else None

    low = high = max(parts.least_bound, BOUNDS[0])
    best = None
    while best is None:
        low, high = high, FIRST_STEP * high
        if high > BOUNDS[1]:
            raise ValueError(
                "no controller bounds the norm: the Riccati equations have no solution within rounding at any bound; "
                "scale the plant's signals, or drive and measure what grows more directly"
            )
        best = within(high)
    while high - low > tolerance * high:
        middle = math.sqrt(low * high)
        found = within(middle)
        low, high, best = (low, middle, found) if found is not None else (middle, high, best)
    return best


def h2_synthesis(plant: LinearModel, *, measured: Names, driven: Names) -> Synthesis:
    """Compute the controller with the least H2 norm from disturbances to errors.

    That is the least rms of the errors under independent white noises of unit intensity (`h2_norm`).

    Args:
        plant: continuous model, as the module describes, without direct feedthrough from disturbances to errors.
        measured: outputs that the controller reads.
        driven: inputs that the controller drives.

    Returns:
        Controller with as many states as the plant, closed loop and its H2 norm.

    Raises:
        ValueError: for a plant that the method excludes; the message names the assumption.

    Source: K. Zhou, J. C. Doyle, K. Glover, Robust and Optimal Control (1996), sec. 14.5.
    """
    parts = _Partition.of(plant, measured, driven)
    if parts.d11.any():
        raise ValueError(
            "direct feedthrough from a disturbance to an error gives white noise of infinite rms; filter it"
        )
    a, b1, b2, c1, c2 = parts.a, parts.b1, parts.b2, parts.c1, parts.c2
    x, y = regulator(a, b2, c1, parts.d12), regulator(a.T, c2.T, b1.T, parts.d21.T)
    feedback = -(b2.T @ x + parts.d12.T @ c1)
    observer = -(y @ c2.T + b1 @ parts.d21.T)
    state = a + b2 @ feedback + observer @ c2

    def norm(closed: LinearModel) -> float:
        return h2_norm(_without_feedthrough(closed))

    found = parts.result((state, -observer, feedback, np.zeros((len(feedback), len(c2)))), norm)
    found = replace(found, closed_loop=_without_feedthrough(found.closed_loop))
    if found.norm == math.inf:
        raise ValueError("rounding makes the closed loop unstable; scale the plant's signals or reduce its states")
    return found


def mixed_sensitivity(
    plant: LinearModel,
    *,
    measured: Names,
    driven: Names,
    performance: LinearModel,
    effort: LinearModel | float,
    robustness: LinearModel | None = None,
    tolerance: float = 1e-3,
) -> Synthesis:
    """Compute the controller with the least H-infinity norm of [W1 S; W2 K S; W3 T].

    S = (1 - G K)^-1 acts on disturbances d at the measured signals, K S is the effort for them, and T = S - 1.

    Args:
        plant: model G from the driven to the measured signals; its other signals are left out.
        measured: outputs that the controller reads.
        driven: inputs that the controller drives.
        performance: weight W1 with one input and one output, used for every measured signal (`weighting_filter`).
        effort: weight W2 for every driven signal, a number or such a model, with gain at high frequency.
        robustness: weight W3 for every measured signal; None for none.
        tolerance: see `hinf_synthesis`.

    Returns:
        As of `hinf_synthesis`, with errors "performance <measured>", "effort <driven>" and "robustness <measured>".

    Raises:
        ValueError: in the cases of `hinf_synthesis`. A plant with poles on the imaginary axis (free motions) is one of
            them, because disturbances at its output do not move them: give `hinf_synthesis` a plant with a disturbance
            at an input.

    Source: S. Skogestad, I. Postlethwaite, Multivariable Feedback Control, 2nd ed. (2005), sec. 9.3.
    """
    seen, pushed = names("measured signal", measured), names("driven signal", driven)
    eye = np.eye(len(seen))
    moved, disturbed = tuple(f"{name} undisturbed" for name in seen), tuple(f"disturbance at {name}" for name in seen)
    rows = [plant.outputs.index(known("output", name, plant.outputs)) for name in seen]
    inner = replace(plant, C=plant.C[rows], D=plant.D[rows], outputs=moved, units=())
    parts = [
        inner,
        static_gain(np.hstack([eye, eye]), inputs=moved + disturbed, outputs=seen),
        _each(performance, seen, tuple(f"performance {name}" for name in seen)),
        _each(effort, pushed, tuple(f"effort {name}" for name in pushed)),
    ]
    if robustness is not None:
        parts.append(_each(robustness, moved, tuple(f"robustness {name}" for name in seen)))
    errors = tuple(name for part in parts[2:] for name in part.outputs)
    joined = interconnect(*parts, inputs=disturbed + pushed, outputs=errors + seen)
    return hinf_synthesis(joined, measured=seen, driven=pushed, tolerance=tolerance)


@dataclass(frozen=True)
class _Partition:
    """A plant in parts, in scaled time and states, with unit direct feedthrough to the errors and measurements.

    Attributes:
        plant: the plant.
        measured: names of the measured outputs.
        driven: names of the driven inputs.
        rate: unit of the scaled time [rad/s].
        a, b1, b2, c1, c2, d11, d12, d21: matrices with d12 = [0; 1] and d21 = [0, 1].
        d22: direct feedthrough from the driven to the measured signals, not scaled.
        drive: driven signals from the scaled ones.
        measure: scaled measured signals from the measured ones.
    """

    plant: LinearModel
    measured: tuple[str, ...]
    driven: tuple[str, ...]
    rate: float
    a: Array
    b1: Array
    b2: Array
    c1: Array
    c2: Array
    d11: Array
    d12: Array
    d21: Array
    d22: Array
    drive: Array
    measure: Array

    @classmethod
    def of(cls, plant: LinearModel, measured: Names, driven: Names) -> "_Partition":
        """Return the parts of a plant.

        Raises:
            ValueError: for unknown names and for assumptions that do not hold.
        """
        check_continuous(plant)
        seen, pushed = names("measured signal", measured), names("driven signal", driven)
        y = [plant.outputs.index(known("output", name, plant.outputs)) for name in seen]
        u = [plant.inputs.index(known("input", name, plant.inputs)) for name in pushed]
        z = [k for k in range(len(plant.outputs)) if k not in y]
        w = [k for k in range(len(plant.inputs)) if k not in u]
        if not z or not w:
            raise ValueError("the plant needs at least one disturbance (an input beside the driven ones) and one error")
        d = plant.D
        _full_rank(d[np.ix_(z, u)], "driven input", "error", "weight the effort of the driven inputs among the errors")
        _full_rank(d[np.ix_(y, w)].T, "measured output", "disturbance", "add noise of the sensors to the disturbances")
        # Rotations of errors and disturbances, which change no norm, and scaled u and y give d12 and d21 their form.
        per_drive, per_sensor = np.linalg.norm(d[np.ix_(z, u)], axis=0), np.linalg.norm(d[np.ix_(y, w)], axis=1)
        left, sizes, right = np.linalg.svd(d[np.ix_(z, u)] / per_drive)
        errors = np.roll(left, -len(u), axis=1).T
        drive = right.T / sizes / per_drive[:, None]
        top, spread, across = np.linalg.svd(d[np.ix_(y, w)] / per_sensor[:, None])
        disturb = np.roll(across.T, -len(y), axis=1)
        measure = top.T / spread[:, None] / per_sensor
        enter = np.hstack([plant.B[:, w] @ disturb, plant.B[:, u] @ drive])
        leave = np.vstack([errors @ plant.C[z], measure @ plant.C[y]])
        rate, a, b, c = scaled(plant.A, enter, leave)
        parts = cls(
            plant=plant,
            measured=seen,
            driven=pushed,
            rate=rate,
            a=a,
            b1=b[:, : len(w)],
            b2=b[:, len(w) :],
            c1=c[: len(z)],
            c2=c[len(z) :],
            d11=errors @ d[np.ix_(z, w)] @ disturb,
            d12=np.eye(len(z), len(u), k=len(u) - len(z)),
            d21=np.eye(len(y), len(w), k=len(w) - len(y)),
            d22=d[np.ix_(y, u)],
            drive=drive,
            measure=measure,
        )
        check_regular(a, parts.b2, parts.c1, parts.d12, "driven inputs", "errors")
        check_regular(a.T, parts.c2.T, parts.b1.T, parts.d21.T, "measured outputs", "disturbances")
        return parts

    @property
    def least_bound(self) -> float:
        """Bound on the norm that no controller can reach."""
        free_z, free_w = len(self.d11) - self.d12.shape[1], self.d11.shape[1] - len(self.d21)
        parts = (self.d11[:free_z], self.d11[:, :free_w])
        return float(max((np.linalg.norm(part, 2) for part in parts if part.size), default=0.0))

    def controller(self, bound: float) -> Matrices | None:
        """Return the central controller whose closed loop has a norm below a bound, or None where there is none."""
        # With errors and effort over the bound, a bound of 1 remains, in any units; states are scaled likewise.
        b1, b2, c1, c2 = self.b1, bound * self.b2, self.c1 / bound, self.c2
        enters, leaves = np.linalg.norm(np.hstack([b1, b2])), np.linalg.norm(np.vstack([c1, c2]))
        factor = math.sqrt(leaves / enters) if enters and leaves else 1.0
        a, b1, b2, c1, c2 = self.a, factor * b1, factor * b2, c1 / factor, c2 / factor
        d11, d12, d21 = self.d11 / bound, self.d12, self.d21
        (nz, nw), nu, ny = d11.shape, d12.shape[1], len(d21)
        b, row = np.hstack([b1, b2]), np.hstack([d11, d12])
        c, column = np.vstack([c1, c2]), np.vstack([d11, d21])
        r = row.T @ row - scipy.linalg.block_diag(np.eye(nw), np.zeros((nu, nu)))
        s = column @ column.T - scipy.linalg.block_diag(np.eye(nz), np.zeros((ny, ny)))
        if (x := care(a, b, c1.T @ c1, r, c1.T @ row)) is None:
            return None
        if (y := care(a.T, c.T, b1 @ b1.T, s, b1 @ column.T)) is None:
            return None
        if np.abs(np.linalg.eigvals(x @ y)).max(initial=0.0) >= 1:
            return None
        f = -np.linalg.solve(r, row.T @ c1 + b.T @ x)
        h = -np.linalg.solve(s, column @ b1.T + c @ y).T
        f12, f2 = f[nw - ny : nw], f[nw:]
        h12, h2 = h[:, nz - nu : nz], h[:, nz:]
        d1111, d1112 = d11[: nz - nu, : nw - ny], d11[: nz - nu, nw - ny :]
        d1121, d1122 = d11[nz - nu :, : nw - ny], d11[nz - nu :, nw - ny :]
        inner = np.linalg.inv(np.eye(nz - nu) - d1111 @ d1111.T)
        direct = -d1121 @ d1111.T @ inner @ d1112 - d1122
        z = np.linalg.inv(np.eye(len(a)) - y @ x)
        seen = c2 + f12  # in the central controller, the square roots of the book's formulas cancel
        first = z @ ((b2 + h12) @ direct - h2)
        return a + b @ f - first @ seen, first, bound * (f2 - direct @ seen), bound * direct

    def result(self, found: Matrices, norm: Norm) -> Synthesis:
        """Return a controller of the scaled plant for the plant, with its closed loop."""
        a, b, c, d = found
        b, c, d = self.rate * b @ self.measure, self.drive @ c, self.drive @ d @ self.measure
        # The parts leave out the direct feedthrough from u to y, which the controller takes off its input.
        loop = np.linalg.inv(np.eye(len(self.d22)) + self.d22 @ d)
        a, b, c, d = self.rate * a - b @ loop @ self.d22 @ c, b @ loop, c - d @ loop @ self.d22 @ c, d @ loop
        a, b, c = balanced_system(a, b, c)
        controller = LinearModel(a, b, c, d, self.measured, self.driven)
        closed = interconnect(
            self.plant,
            controller,
            inputs=[name for name in self.plant.inputs if name not in self.driven],
            outputs=[name for name in self.plant.outputs if name not in self.measured],
        )
        return Synthesis(controller, closed, norm(closed))


def _without_feedthrough(model: LinearModel) -> LinearModel:
    """Return a model without direct feedthrough, which is rounding where no part of a closed loop has any."""
    return replace(model, D=np.zeros_like(model.D))


def _full_rank(d: Array, signal: str, other: str, cure: str) -> None:
    """Raise ValueError unless the columns of a direct feedthrough are independent, whatever their units."""
    columns = np.linalg.norm(d, axis=0)
    if d.shape[0] < d.shape[1] or not columns.all() or np.linalg.cond(d / columns) >= 1 / RANK:
        raise ValueError(
            f"every {signal} must have its own direct feedthrough, with full rank, between it and the {other}s: {cure}"
        )


def _each(weight: LinearModel | float, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> LinearModel:
    """Return a weight of one signal for each of several.

    Raises:
        ValueError: for a weight with other than one input and one output.
    """
    if not isinstance(weight, LinearModel):
        return static_gain(positive("weight", weight) * np.eye(len(inputs)), inputs=inputs, outputs=outputs)
    if weight.D.shape != (1, 1):
        raise ValueError(f"a weight has one input and one output, got {weight.D.shape[1]} and {weight.D.shape[0]}")
    a, b, c, d = (np.kron(np.eye(len(inputs)), part) for part in weight.matrices)
    return LinearModel(a, b, c, d, inputs, outputs, time_step=weight.time_step)
