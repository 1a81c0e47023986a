"""Two hundred random scenes of small motion against their own equations, made and solved by hand.

Point masses that only shift, on springs and dampers in random directions: M q'' + C q' + K q = f, in a frame that turns
at W with 2 M W~ beside C and M W~ W~ beside K. Responses come from a solve per point, zeros from the poles with the
pushed points held, mean squares from Lyapunov's equation.
"""

import itertools

import numpy as np
import pytest
import scipy.linalg

from nassim import Encoder, Joint, PointForce, RigidBody, Scene, SpringDamper, frequency_response, linearize
from nassim.base.rigid_motion import skew
from nassim.systems import noise_budget, sampled, zeros

KINDS = ("free", "damped", "spinning", "sampled")
PER_KIND = 50
SAME = 1e-8


class Machine:
    """A random scene, and its equations by hand: mass, damper and spring, (3 n, 3 n); forces and readings, (2, 3 n)."""

    def __init__(self, kind, seed):
        random = np.random.default_rng([KINDS.index(kind), seed])
        n = int(random.integers(2, 5))
        size = 3 * n
        mass = 10 ** random.uniform(-1, 2, n)
        self.mass, self.damper, self.spring = np.diag(np.repeat(mass, 3)), np.zeros((size, size)), np.zeros((size, size))
        places = random.normal(size=(n, 3))
        base = RigidBody("base", {f"p{k}": place for k, place in enumerate(places)}, fixed=True)
        bodies = [RigidBody(f"m{k}", {"c": np.zeros(3)}, mass[k], np.eye(3), places[k]) for k in range(n)]
        slides = [Joint(f"j{k}", f"base.p{k}", f"m{k}.c", ("x", "y", "z")) for k in range(n)]
        # A free machine's masses hold each other only; all others hang on the base too, the first one by springs.
        pairs = [(a, b) for a, b in itertools.combinations(range(n), 2) if b == a + 1 or random.random() < 0.3]
        pairs += [] if kind == "free" else [(None, k) for k in range(n) if k == 0 or random.random() < 0.5]
        stiff, springs = 10 ** random.uniform(3, 5), []
        for (a, b), axis in itertools.product(pairs, range(3)):
            row, direction = np.zeros(size), random.normal(size=3)
            direction /= np.linalg.norm(direction)
            row[3 * b : 3 * b + 3] = direction
            if a is not None:
                row[3 * a : 3 * a + 3] = -direction
            k, c = stiff * 10 ** random.uniform(-1, 1), 10 ** random.uniform(-1, 2)
            self.spring += k * np.outer(row, row)
            self.damper += c * np.outer(row, row)
            start = f"base.p{b}" if a is None else f"m{a}.c"
            name = f"{start}-m{b}-{axis}"
            springs.append(SpringDamper(name, start, f"m{b}.c", tuple(direction), k, c, frame=start))
        self.forces = np.zeros((2, size))
        pushes, sensors = [], []
        for row, (k, direction) in zip(self.forces, enumerate(random.normal(size=(2, 3))), strict=False):
            row[3 * k : 3 * k + 3] = direction / np.linalg.norm(direction)
            pushes.append(PointForce(f"f{k}", f"m{k}.c", tuple(direction), f"f{k}"))
            sensors.append(Encoder(f"x{k}", f"base.p{k}", f"m{k}.c", tuple(direction)))
        self.scene = Scene(
            "machine", (base, *bodies), tuple(slides), tuple(pushes), tuple(sensors), tuple(springs), damping_ratio=0.0
        )
        self.velocity = np.zeros(3)
        if kind == "spinning":
            softest = np.sqrt(scipy.linalg.eigh(self.spring, self.mass, eigvals_only=True)[0])
            self.velocity = 0.3 * softest * direction / np.linalg.norm(direction)
            turn = np.kron(np.eye(n), skew(self.velocity))
            self.damper, self.spring = self.damper + 2 * self.mass @ turn, self.spring + self.mass @ turn @ turn
        self.rate = 3.0 * np.abs(self.poles(self.mass, self.damper, self.spring)).max() / np.pi

    def model(self, kind):
        turns = {"angular_velocity": self.velocity} if np.any(self.velocity) else {}
        model = linearize(self.scene, **turns)
        return sampled(model, self.rate) if kind == "sampled" else model

    @staticmethod
    def state(mass, damper, spring):
        inverse = np.linalg.inv(mass)
        return np.block([[np.zeros_like(mass), np.eye(len(mass))], [-inverse @ spring, -inverse @ damper]])

    @classmethod
    def poles(cls, mass, damper, spring):
        return np.linalg.eigvals(cls.state(mass, damper, spring))

    @property
    def system(self):
        """A, B and C."""
        still = np.zeros_like(self.forces)
        b = np.hstack([still, self.forces @ np.linalg.inv(self.mass)]).T
        return self.state(self.mass, self.damper, self.spring), b, np.hstack([self.forces, still])

    def response(self, kind, frequency):
        """Outputs over forces, (2, 2, n)."""
        s = 2j * np.pi * frequency
        if kind != "sampled":
            dynamic = [x**2 * self.mass + x * self.damper + self.spring for x in s]
            return np.array([self.forces @ np.linalg.solve(z, self.forces.T) for z in dynamic]).transpose(1, 2, 0)
        a, b, c = self.system
        joint = scipy.linalg.expm(np.block([[a, b], [np.zeros((2, len(a) + 2))]]) / self.rate)
        step, held = joint[: len(a), : len(a)], joint[: len(a), len(a) :]
        z = np.exp(s / self.rate)
        return np.array([c @ np.linalg.solve(x * np.eye(len(a)) - step, held) for x in z]).transpose(1, 2, 0)
