"""Two hundred random scenes of small motion against their own equations, made and solved by hand.

Masses that shift without turning, on springs and dampers in random directions: M q'' + C q' + K q = f; on a table that
turns at W, C has 2 M W~ besides and K has M W~ W~. Responses come from a solve per point, zeros from the poles with the
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
AT_REST = 1e-6
"""Share of the fastest zero below which one is at rest: double zeros there are known to the root of rounding."""
LEVELS = np.array([2.0, 0.3])


class Machine:
    """A random scene, its linear model, and its equations by hand: M, C, K (3 n, 3 n) and forces' directions (2, 3 n).

    What is pushed is also read. A free machine's masses hold each other only; all others hang on the base too.
    """

    def __init__(self, kind, seed):
        random = np.random.default_rng([KINDS.index(kind), seed])
        n = int(random.integers(2, 4))
        masses, places = 10 ** random.uniform(-0.5, 1.5, n), random.normal(size=(n, 3))
        self.kind, self.mass = kind, np.diag(np.repeat(masses, 3))
        self.damper, self.spring = np.zeros_like(self.mass), np.zeros_like(self.mass)
        base = RigidBody("base", {f"p{k}": place for k, place in enumerate(places)}, fixed=True)
        bodies = [RigidBody(f"m{k}", {"c": np.zeros(3)}, masses[k], np.eye(3), places[k]) for k in range(n)]
        slides = [Joint(f"j{k}", f"base.p{k}", f"m{k}.c", ("x", "y", "z")) for k in range(n)]
        pairs = [(a, b) for a, b in itertools.combinations(range(n), 2) if b == a + 1 or random.random() < 0.3]
        if kind != "free":
            pairs += [(None, k) for k in range(n) if k == 0 or random.random() < 0.5]
        springs = []
        for a, b in pairs:
            for k, axis in enumerate(np.linalg.qr(random.normal(size=(3, 3)))[0]):
                stiffness, damping = 10 ** random.uniform(3, 5), 10 ** random.uniform(-1, 2)
                row = np.kron(np.eye(n)[b] - (0 if a is None else np.eye(n)[a]), axis)
                self.spring += stiffness * np.outer(row, row)
                self.damper += damping * np.outer(row, row)
                ends = f"base.p{b}" if a is None else f"m{a}.c", f"m{b}.c"
                springs.append(SpringDamper(f"{ends}{k}", *ends, tuple(axis), stiffness, damping, frame=ends[0]))
        axes = random.normal(size=(2, 3))
        self.forces = np.array([np.kron(np.eye(n)[k], axis / np.linalg.norm(axis)) for k, axis in enumerate(axes)])
        pushes = [PointForce(f"f{k}", f"m{k}.c", tuple(axis), f"f{k}") for k, axis in enumerate(axes)]
        sensors = [Encoder(f"x{k}", f"base.p{k}", f"m{k}.c", tuple(axis)) for k, axis in enumerate(axes)]
        scene = Scene("machine", (base, *bodies), tuple(slides), tuple(pushes), tuple(sensors), tuple(springs),
                      damping_ratio=0.0)  # fmt: skip
        velocity = np.zeros(3)
        if kind == "spinning":
            softest = np.sqrt(scipy.linalg.eigh(self.spring, self.mass, eigvals_only=True)[0])
            velocity = 0.3 * softest * np.linalg.qr(random.normal(size=(3, 3)))[0][0]
            turn = np.kron(np.eye(n), skew(velocity))
            self.damper, self.spring = self.damper + 2 * self.mass @ turn, self.spring + self.mass @ turn @ turn
        self.model = linearize(scene, angular_velocity=velocity)
        poles = np.sort(np.abs(np.linalg.eigvals(self.continuous(np.eye(len(self.mass)))[0]))) / (2 * np.pi)
        self.slowest, self.fastest = poles[poles > AT_REST * poles[-1]][[0, -1]]
        if kind == "sampled":
            self.model = sampled(self.model, 6 * self.fastest)
        self.system = self.continuous(np.eye(len(self.mass)))

    def continuous(self, basis):
        """A, B and C by hand, of motion within a basis."""
        m, c, k = (basis.T @ matrix @ basis for matrix in (self.mass, self.damper, self.spring))
        inverse, forces = np.linalg.inv(m), self.forces @ basis
        still = np.zeros_like(forces)
        a = np.block([[np.zeros_like(m), np.eye(len(m))], [-inverse @ k, -inverse @ c]])
        b, c = np.hstack([still, forces @ inverse]).T, np.hstack([forces, still])
        if self.model.time_step is not None:
            joint = scipy.linalg.expm(self.model.time_step * np.block([[a, b], [np.zeros((2, len(a) + 2))]]))
            a, b = joint[: len(a), : len(a)], joint[: len(a), len(a) :]
        return a, b, c

    def response(self, frequency):
        """Outputs over forces, (2, 2, n)."""
        s = 2j * np.pi * frequency
        if self.model.time_step is None:
            dynamic = (x**2 * self.mass + x * self.damper + self.spring for x in s)
            values = [self.forces @ np.linalg.solve(z, self.forces.T) for z in dynamic]
        else:
            a, b, c = self.system
            values = [c @ np.linalg.solve(z * np.eye(len(a)) - a, b) for z in np.exp(s * self.model.time_step)]
        return np.array(values).transpose(1, 2, 0)

    def zeros(self, which):
        """Zeros between some of the forces and the points that they push; of a sampled machine in the plane of z.

        Held points move no output: these are the poles of what still moves. A sampled output C (A x + B u) stays
        zero by u = -(C B)^-1 C A x.
        """
        if self.model.time_step is None:
            return np.linalg.eigvals(self.continuous(scipy.linalg.null_space(self.forces[which]))[0])
        a, b, c = self.system
        b, c = b[:, which], c[which]
        every = np.linalg.eigvals(a - b @ np.linalg.solve(c @ b, c @ a))
        return every[np.argsort(np.abs(every))[len(which) :]]

    def mean_squares(self):
        """Of each output by each force's white noise, (2, 2)."""
        a, b, c = self.system
        each = []
        for column, level in zip(b.T, LEVELS, strict=True):
            if self.model.time_step is None:
                states = scipy.linalg.solve_continuous_lyapunov(a, -level / 2 * np.outer(column, column))
            else:
                variance = level / 2 / self.model.time_step
                states = scipy.linalg.solve_discrete_lyapunov(a, variance * np.outer(column, column))
            each.append(np.diag(c @ states @ c.T))
        return np.transpose(each)


@pytest.mark.parametrize("kind", KINDS)
def test_random_scenes_equal_a_direct_solve(kind):
    for seed in range(PER_KIND):
        machine = Machine(kind, seed)
        model = machine.model
        still = np.count_nonzero(~np.any(model.A, axis=1))
        assert still == (3 if kind == "free" else 0), f"rigid-body motions that nothing brakes of {kind} machine {seed}"
        highest = 10 * machine.fastest if kind != "sampled" else 2.4 * machine.fastest
        frequency = np.geomspace(0.2 * machine.slowest, highest, 25)
        expected = machine.response(frequency)
        error = np.abs(frequency_response(model, frequency).values - expected) / np.abs(expected)
        assert error.max() < SAME, f"response of {kind} machine {seed}"

        for which in ([0], [1], [0, 1]):
            names = {"inputs": [f"f{k}" for k in which], "outputs": [f"x{k}" for k in which]}
            found, expected = zeros(model, **names), machine.zeros(which)
            if kind == "sampled":
                found = np.exp(found * model.time_step)
            distance = np.abs(found[:, None] - expected)
            rows, columns = scipy.optimize.linear_sum_assignment(distance)
            at_rest = np.abs(expected[columns]) < AT_REST * np.abs(expected).max()
            allowed = np.where(at_rest, AT_REST * np.abs(expected).max(), SAME * np.abs(expected[columns]))
            assert len(found) == len(expected), f"zeros of {kind} machine {seed}"
            assert np.all(distance[rows, columns] < allowed), f"zeros of {kind} machine {seed}"

        ends = 0.2 * machine.slowest, (3 if kind == "sampled" else 30) * machine.fastest
        band = np.geomspace(*ends, 80)
        if kind != "free":
            band[0] = 0.0
        budget = noise_budget(model, {"f0": LEVELS[0], "f1": LEVELS[1]}, band)
        chosen = np.unique([*range(0, len(budget.frequency), 20), len(budget.frequency) - 1])
        chosen = chosen[budget.frequency[chosen] <= 10 * machine.fastest]
        amplitude = np.abs(machine.response(budget.frequency[chosen])) * np.sqrt(LEVELS)[:, None]
        assert np.sqrt(budget.psd[..., chosen]) == pytest.approx(amplitude, rel=SAME, abs=0)
        if kind != "free":
            assert budget.rms() ** 2 == pytest.approx(machine.mean_squares(), rel=4e-3, abs=0)
