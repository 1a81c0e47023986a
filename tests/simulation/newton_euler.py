"""Rigid bodies in large motion by Newton's and Euler's equations and SciPy: shares no code with nassim."""

from dataclasses import dataclass

import numpy as np
import scipy.integrate

EPS = 1e-6


def cross_matrix(v):
    """Of v x."""
    return np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])


@dataclass
class Motion:
    """Of one body: position p of its centre, turn R since the start, velocity v, angular velocity w, world frame."""

    p: np.ndarray
    R: np.ndarray
    v: np.ndarray
    w: np.ndarray

    def at(self, arm):
        """Where a point is; arm: from the centre, world frame at the start."""
        return self.p + self.R @ arm

    def speed(self, arm):
        return self.v + np.cross(self.w, self.R @ arm)


def unpack(y):
    return [Motion(s[:3], s[3:12].reshape(3, 3), s[12:15], s[15:]) for s in np.reshape(y, (-1, 18))]


def wrench(force, at, body):
    """Force (3,) at a place, as force and moment about the centre."""
    return np.concatenate([force, np.cross(at - body.p, force)])


def point_rows(n, k, motion, arm, sign=1.0):
    """Velocity of a point per unit of all twists (v, w), (3, 6 n)."""
    rows = np.zeros((3, 6 * n))
    rows[:, 6 * k : 6 * k + 3] = sign * np.eye(3)
    rows[:, 6 * k + 3 : 6 * k + 6] = -sign * cross_matrix(motion.R @ arm)
    return rows


def integrate(masses, inertias, positions, spins, time, forces, rows=None, velocities=None):
    """Motions of bodies, for each time a list of `Motion`.

    inertias: about the centres, along the world's axes at the start; forces(t, motions): (6,) of each body
    rows(motions): of constraints on velocities, (m, 6 n), kept as accelerations
    """
    n = len(masses)

    def rate(t, y):
        motions = unpack(y)
        mass = np.zeros((6 * n, 6 * n))
        push = np.concatenate(forces(t, motions))
        derivative = []
        for k, m in enumerate(motions):
            inertia = m.R @ inertias[k] @ m.R.T
            place = slice(6 * k, 6 * k + 6)
            mass[place, place][:3, :3] = masses[k] * np.eye(3)
            mass[place, place][3:, 3:] = inertia
            push[place][3:] -= np.cross(m.w, inertia @ m.w)
            derivative.append(np.concatenate([m.v, (cross_matrix(m.w) @ m.R).ravel(), np.zeros(6)]))
        twists = np.concatenate([np.concatenate([m.v, m.w]) for m in motions])
        if rows is None:
            rates = np.linalg.solve(mass, push)
        else:
            flow = np.concatenate(derivative)
            jacobian = rows(motions)
            drift = (rows(unpack(y + EPS * flow)) - rows(unpack(y - EPS * flow))) @ twists / (2 * EPS)
            m = len(jacobian)
            whole = np.block([[mass, jacobian.T], [jacobian, np.zeros((m, m))]])
            rates = np.linalg.solve(whole, np.concatenate([push, -drift]))[: 6 * n]
        for k, d in enumerate(derivative):
            d[12:] = rates[6 * k : 6 * k + 6]
        return np.concatenate(derivative)

    velocities = np.zeros((n, 3)) if velocities is None else velocities
    start = [np.concatenate([p, np.eye(3).ravel(), v, w]) for p, v, w in zip(positions, velocities, spins, strict=True)]
    found = scipy.integrate.solve_ivp(
        rate, (0, time[-1]), np.concatenate(start), t_eval=time, method="DOP853", rtol=1e-9, atol=1e-11
    )
    return [unpack(y) for y in found.y.T]
