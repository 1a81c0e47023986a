"""Functions of the angle of a path: splines through all angles of assembly, parabolas through three neighbours."""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import BSpline, make_interp_spline

from nassim.base.checks import Array


@dataclass(frozen=True)
class PathSpline:
    """A function of the path's angle, joined by splines of order 5.

    Attributes:
        spline: the spline over the angle.
        turn: start of a turn after which it repeats [rad]; None where it does not.
    """

    spline: BSpline
    turn: float | None

    @classmethod
    def of(cls, angles: Array, values: Array, *, closed: bool) -> "PathSpline":
        """Join values (k, ...) at evenly spaced angles (k,); closed: whether the first follows the last."""
        first = float(angles[0])
        if closed:  # a spline over more than a turn, of which the middle is used
            n, step, more = len(angles), float(angles[1] - angles[0]), 8
            places = np.arange(-more, n + more + 1)
            angles, values = first + step * places, values[places % n]
        return cls(make_interp_spline(angles, values, k=5), first if closed else None)

    def at(self, angle: Array, derivative: int = 0) -> Array:
        """Evaluate the function, or a derivative with respect to the angle, at angles (n,); shape (n, ...)."""
        if self.turn is not None:
            angle = self.turn + np.mod(angle - self.turn, 2 * np.pi)
        return self.spline(angle, derivative)


def parabola(index: int, share: float, n: int, *, closed: bool) -> dict[int, float]:
    """Return weights of three of n knots for the value at a share of the spacing beside one of them, by their index."""
    middle = index if closed else int(np.clip(index, 1, n - 2))
    x = share + index - middle
    weights = {-1: 0.5 * x * (x - 1), 0: 1 - x**2, 1: 0.5 * x * (x + 1)}
    return {(middle + k) % n: weight for k, weight in weights.items()}
