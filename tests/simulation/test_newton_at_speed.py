"""Newton's iterations of machines that turn: when their Jacobian is renewed, and how it is factorised."""

from types import SimpleNamespace

import numpy as np
import pytest
from conftest import lattice

from nassim import Encoder, FlexibleBody, PointForce, RigidBody, Scene, TimeHistory, craig_bampton, revolute, simulate
from nassim.simulation.exudyn import jacobian_renewal
from nassim.simulation.exudyn.jacobian_renewal import COST, FEW, STEPS, JacobianRenewal
from nassim.simulation.exudyn.system import build_system
from nassim.simulation.model.assembly import assemble
from nassim.simulation.run import preparation as exudyn_build


class Solver:
    """Counts as Exudyn's: so many iterations a step since the last Jacobian."""

    def __init__(self, iterations):
        self.iterations, self.since = iterations, 0
        self.it = SimpleNamespace(newtonStepsCount=0, newtonJacobiCount=0)
        self.newton = SimpleNamespace(modifiedNewtonContractivity=0.5)

    def step(self):
        if self.newton.modifiedNewtonContractivity < 0.5 or not self.it.newtonJacobiCount:
            self.it.newtonJacobiCount += 1
            self.since = 0
        self.it.newtonStepsCount += self.iterations(self.since)
        self.since += 1


def renewals(iterations, steps=400):
    solver = Solver(iterations)
    rule = JacobianRenewal(solver)
    for _ in range(steps):
        rule.begin_step()
        solver.step()
    return solver.it.newtonJacobiCount - 1, solver.it.newtonStepsCount


def test_a_jacobian_is_renewed_where_that_pays():
    """Where iterations grow by one in ten steps the best interval is sqrt(2 COST 10), some 22 steps."""
    count, iterations = renewals(lambda since: 2 + since // 10)
    assert 400 / 40 <= count <= 400 / 16
    assert COST * count + iterations < 0.4 * sum(2 + k // 10 for k in range(400))
    assert renewals(lambda since: 7)[0] == 0  # a new one would be no better
    assert renewals(lambda since: min(1 + since, FEW))[0] == 0


def test_a_restored_rule_goes_on_as_it_would_have():
    def intervals(again):
        solver, found = Solver(lambda since: 2 + since // 10), []
        rule = JacobianRenewal(solver)
        for k in range(100):
            if k in again:
                rule.restore(rule.state)
                solver.it.newtonJacobiCount += 1  # Newton's iterations ask for the Jacobian of the state
            rule.begin_step()
            found.append(solver.newton.modifiedNewtonContractivity)
            solver.step()
        return found

    assert intervals({3, STEPS, 3 * STEPS + 5, 50}) == intervals(())


@pytest.fixture(scope="module")
def bar():
    return craig_bampton(lattice(), n_modes=2, progress=False)


def test_a_turning_bar_needs_fewer_iterations_and_moves_as_before(bar, monkeypatch):
    left = bar.point("left").position
    scene = Scene(
        "rotor",
        (RigidBody("ground", {"hub": left}, fixed=True), FlexibleBody("bar", bar, angular_velocity=(0, 0, 20.0))),
        (revolute("axle", "ground.hub", "bar.left"),),
        (PointForce("push", "bar.right", "x", "force", frame="bar.right"),),
        (Encoder("reach", "ground.hub", "bar.right", "line"),),
        damping_ratio=0.0,
    )
    time = np.arange(401) * 1e-4
    push = TimeHistory(time, 0.1 * np.sin(500 * time)[None], ("force",), ("N",))

    def run():
        systems = []
        build = exudyn_build.build_system
        with monkeypatch.context() as kept:
            kept.setattr(exudyn_build, "build_system", lambda *given: systems.append(build(*given)) or systems[-1])
            reach = simulate(scene, push, time_step=1e-4, start="released", progress=False)["reach"]
        return reach, systems[0].mbs.sys["dynamicSolver"].it.newtonStepsCount

    reach, iterations = run()
    monkeypatch.setattr(jacobian_renewal, "FEW", np.inf)
    expected, more = run()
    assert iterations < 0.9 * more
    np.testing.assert_allclose(reach, expected, rtol=0, atol=1e-6 * np.abs(expected).max())


def test_the_factorisation_fits_what_the_jacobian_holds(bar):
    """A chain of rigid bodies couples neighbours only; bars couple their own coordinates."""
    inertia, ends = 1e-4 * np.eye(3), {"a": (-0.05, 0, 0), "z": (0.05, 0, 0)}
    links = [RigidBody(f"link{k}", ends, 0.1, inertia, (0.1 * k + 0.05, 0, 0)) for k in range(12)]
    ground = RigidBody("ground", {"z": np.zeros(3)}, fixed=True)
    before = ["ground", *(link.name for link in links)]
    joints = [revolute(f"pin{k}", f"{before[k]}.z", f"{link.name}.a", "y") for k, link in enumerate(links)]
    assert build_system(assemble(Scene("chain", (ground, *links), tuple(joints)))).sparse
    bars = [FlexibleBody(f"bar{k}", bar, (0.1 * k, 0, 0)) for k in range(3)]
    assert not build_system(assemble(Scene("bars", tuple(bars)))).sparse
