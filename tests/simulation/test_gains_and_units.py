"""A reading of gain g is g times that of gain 1, and an input of gain g does what g times one of gain 1 does.

In every route: linear models at rest, on a spindle and under loads, statics, exact steps, runs by Exudyn with its
faster items and its general ones, along a path, step by step, in noise budgets.
"""

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pytest
from test_order_of_parts import AXIS, OTHER, RAIL, STEP, bar, machine

from nassim import (
    PointForce,
    RigidBody,
    Scene,
    Simulation,
    SpringDamper,
    TimeHistory,
    frequency_response,
    linearize,
    prismatic,
    simulate,
    static_response,
)
from nassim.scene import (
    AppliedForce,
    BodyCoordinates,
    CircuitState,
    CoilForce,
    Combination,
    Displacement,
    Distance,
    Feedthrough,
    Output,
    OutputFilter,
    PointVelocity,
    RotationAngle,
    RotationDeviation,
    Sensor,
    Shunt,
    Term,
)
from nassim.simulation import spinning_equilibrium
from nassim.simulation.exudyn import outputs as of_exudyn
from nassim.systems import noise_budget

GAIN = -1.7
CONSTANT = 0.3
UNSEEN = 1e-11
"""Readings so small count as none, in each unit."""
HINGE = 1.3 * OTHER[:, 2]
"""Axis of the wheel, of a length that multiplies the angle."""


@dataclass(frozen=True)
class Given(Sensor):
    """A part of given terms."""

    of: tuple[Term, ...] = ()

    def terms(self, scene):
        """The given ones."""
        return self.of


def readings(kind):
    """Terms of outputs of gain 1, by name."""
    weights = 1e-4 * bar().stiffness_matrix @ np.linspace(2.0, -1.5, 14)
    """Rigid motion has no share in it."""
    level = Displacement.between("table.mount", "bob.c", AXIS, axes_of="table.mount")
    line, angle = Distance("table.rail", "bob.far"), RotationAngle("wheel.hub", HINGE, "load.hub")
    strain = BodyCoordinates("left/bar", weights, of_strain=True)
    values = {
        "level": level,
        "world": Displacement.between("table.mount", "bob.c", AXIS),
        "line": line,
        "twist": angle,
        "tilt": RotationAngle("bob.c", RAIL),
        "deviation": RotationDeviation("bob.c", "wheel.rim", RAIL, "load.hub", "wheel.hub", HINGE / 1.3),
        "stretch": BodyCoordinates("right/bar", weights),
        "strain": strain,
        "sum": Combination(((2.0, level), (-0.3, line))),
        "strained": replace(strain, constant=CONSTANT),
        "combined": Combination(((0.5, strain), (0.5, replace(strain, constant=2 * CONSTANT)))),
    }
    if kind == "spinning":  # a linear model has no reading about an axis that the machine does not turn with
        del values["tilt"], values["world"]
    found = {name: (Output("", "1", measure),) for name, measure in values.items()}
    if kind == "led":  # fewer, as each takes its time along the path
        return {name: found[name] for name in ("level", "twist", "strain", "strained", "combined")}
    speed, pace = (PointVelocity(((path, RAIL),), path) for path in ("bob.far", "load.rim"))
    rates = {
        "line's rate": (line, 1),
        "turning": (PointVelocity((("wheel.hub", HINGE), ("load.hub", -HINGE)), "load.hub", angular=True), 1),
        "speed": (speed, 1),
        "pace": (pace, 1),
        "speeds": (Combination(((2.0, speed), (-0.7, pace))), 1),
    }
    found |= {name: (Output("", "1", measure, derivative=n),) for name, (measure, n) in rates.items()}
    felt = PointVelocity((("bob.far", AXIS),), "bob.far")
    if kind != "spinning":
        filtered = (Output("", "1", felt, 1.0, 2, True), OutputFilter("", "low", 300.0, 0.5))
        charge, store = replace(strain, weights=1e-4 * weights, of_strain=False), 1e-6
        found |= {
            "felt": filtered,
            "direct": (Output("", "1", level), Feedthrough("", "push", 0.01, 80.0)),
            "passed": (Output("", "1", level), Feedthrough("", "push", 0.01), OutputFilter("", "low", 300.0)),
            "current": (Output("", "1", level, -5.0 / 0.01), CircuitState("", "coil")),
            "port": (Output("", "1", charge, -1 / store), Shunt("", charge, store, 1e4, 1.0)),
        }
    return found


def called(name, gain, terms):
    """Terms of an output with its name and gain."""
    for term in terms:
        field = "name" if isinstance(term, Output) else "output"
        scaled = {} if isinstance(term, OutputFilter) else {"gain": gain * term.gain}
        yield replace(term, **{field: name}, **scaled)


@cache
def measured(kind, fidelity, **options):
    """The machine with each reading of gain 1, of gain GAIN, and of that gain in two terms that add."""
    sensors = []
    for name, terms in readings(kind).items():
        parts = [term for term in terms if not isinstance(term, OutputFilter)]
        share = called(f"{name} in parts", -0.4, terms), called(f"{name} in parts", GAIN + 0.4, parts)
        sensors.append(Given(name, tuple(called(name, 1.0, terms))))
        sensors.append(Given(f"{name} scaled", tuple(called(f"{name} scaled", GAIN, terms))))
        sensors.append(Given(f"{name} in parts", tuple([*share[1], *share[0]])))
    if "current" in readings(kind):
        along = Displacement.between("table.mount", "bob.c", AXIS, axes_of="table.mount")
        sensors.append(Given("coil", (CoilForce("coil", "volts", along, 5.0, 2.0, 0.01),)))
    return replace(machine(kind, fidelity, **options), sensors=sensors)


def assert_scaled(kind, found, within=1e-11, gain=GAIN, names=None):
    """By name: scaled readings are GAIN times the others, and a constant strain is in one of them."""
    for name in names or readings(kind):
        size = np.abs(found[name]).max()
        for way in ("scaled", "in parts"):
            np.testing.assert_allclose(
                found[f"{name} {way}"],
                gain * np.asarray(found[name]),
                rtol=0,
                atol=within * size + UNSEEN,
                err_msg=name,
            )
    if "speeds" in found and gain == GAIN:
        both = 2.0 * np.asarray(found["speed"]) - 0.7 * np.asarray(found["pace"])
        np.testing.assert_allclose(found["speeds"], both, rtol=0, atol=1e-9 * np.abs(both).max() + UNSEEN)


def assert_constant(found):
    for name in ("strained", "combined"):
        np.testing.assert_allclose(np.subtract(found[name], found["strain"]), CONSTANT, rtol=1e-9)


def signals(scene, n, sizes):
    """Pulses of some inputs."""
    time = STEP * np.arange(n + 1)
    values = [sizes.get(name, 0.0) * np.sin(np.pi * np.arange(n + 1) / n) ** 2 for name in scene.inputs]
    return TimeHistory(time, values, scene.inputs, [scene.input_unit(name) for name in scene.inputs])


PUSHED = {"push": 0.4, "pull": -0.3, "left/voltage": 2.0, "right/voltage": 3.0}


def by_name(record):
    return dict(zip(record.names, record.values, strict=True))


@pytest.mark.parametrize(("kind", "fidelity"), [("resting", "linear"), ("spinning", "ffrf")])
def test_readings_of_linear_models_and_at_rest(kind, fidelity):
    scene = measured(kind, fidelity)
    model = linearize(scene, constant_inputs=PUSHED)
    frf = frequency_response(model, [1.0, 10.0, 150.0])
    assert_scaled(kind, dict(zip(frf.outputs, frf.values, strict=True)), within=1e-9)
    budget = noise_budget(model, dict.fromkeys(model.inputs, 1e-3), [1.0, 10.0, 150.0])
    assert_scaled(kind, dict(zip(budget.outputs, budget.psd, strict=True)), gain=GAIN**2)
    if kind == "spinning":
        rest = spinning_equilibrium(scene)
        assert_scaled(kind, rest)
        assert_constant(rest)


@pytest.mark.parametrize("fidelity", ["linear", "ffrf", "rigid"])
def test_readings_in_statics(fidelity):
    found = static_response(measured("resting", fidelity), PUSHED)
    assert_scaled("resting", found)
    assert_constant(found)


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_readings_in_runs_without_loads(method):
    """About the reference configuration itself."""
    scene = measured("resting", "linear", gravity=(0.0, 0.0, 0.0))
    found = by_name(simulate(scene, signals(scene, 16, PUSHED), time_step=STEP, method=method, progress=False))
    assert_scaled("resting", found)
    assert_constant(found)


@pytest.mark.parametrize(
    ("kind", "fidelity", "method"),
    [
        ("resting", "linear", "exact"),
        ("resting", "linear", "generalized_alpha"),
        ("resting", "ffrf", "generalized_alpha"),
        ("spinning", "ffrf", "exact"),
        ("spinning", "ffrf", "generalized_alpha"),
        ("turning", "ffrf", "generalized_alpha"),
        ("turning", "rigid", "general items"),
        ("led", "ffrf", "exact"),
    ],
)
def test_readings_in_runs(kind, fidelity, method, monkeypatch):
    """With a wheel that turns far beyond half a turn."""
    if method == "general items":
        monkeypatch.setattr(of_exudyn, "FASTER_OUTPUTS", {})
        method = "generalized_alpha"
    scene = measured(kind, fidelity)
    more = {"resting": {"quake": 1.0}, "turning": {"torque": 3.6, "angle": 0.4}, "led": {"angle": 0.1}}
    given = signals(scene, 30 if kind == "turning" else 16, PUSHED | more.get(kind, {}))
    found = by_name(simulate(scene, given, time_step=STEP, method=method, progress=False))
    assert_scaled(kind, found)
    assert_constant(found)
    if kind == "turning":
        assert np.ptp(found["twist"]) > 1.3 * 1.5 * np.pi


def test_engines_read_the_same():
    """Exact steps and those of generalized-alpha in small motion, with floating frames, within 3 % of the change."""
    records = []
    for fidelity, method in (("linear", "exact"), ("linear", "generalized_alpha"), ("ffrf", "generalized_alpha")):
        scene = measured("resting", fidelity)
        options = {"constant_inputs": {"push": 0.3, "left/voltage": 1.0}, "time_step": STEP, "progress": False}
        found = by_name(simulate(scene, signals(scene, 24, PUSHED), method=method, **options))
        records.append({name: found[name] for name in scene.outputs})
    for name, expected in records[0].items():
        for record in records[1:]:
            within = 0.03 * np.ptp(expected) + UNSEEN
            np.testing.assert_allclose(record[name], expected, rtol=0, atol=within, err_msg=name)


def test_readings_step_by_step():
    for kind, fidelity, method in (("turning", "rigid", "generalized_alpha"), ("resting", "linear", "exact")):
        scene = measured(kind, fidelity)
        given = signals(scene, 30 if kind == "turning" else 16, PUSHED | {"torque": 3.6 if kind == "turning" else 0.0})
        with Simulation(scene, time_step=STEP, method=method) as run:
            for values in given.values.T[1:]:
                run.step(dict(zip(given.names, values.tolist(), strict=True)))
        found = by_name(run.record)
        assert_scaled(kind, found)
        assert_constant(found)
        assert kind != "turning" or np.ptp(found["twist"]) > 1.3 * 1.5 * np.pi


@cache
def pushed(kind, fidelity):
    """The machine with inputs of gain 1 and of gain GAIN along the same measures, some behind an amplifier."""
    level = Displacement.between("table.mount", "bob.c", AXIS, axes_of="table.mount")
    line, hinge = Distance("table.rail", "bob.far"), RotationAngle("wheel.hub", HINGE, "load.hub")
    along = {
        "across": (level, 0.2, np.inf),
        "apart": (line, -0.3, 90.0),
        "motor": (hinge, 2e-4, np.inf),
        "stacks": (
            BodyCoordinates("left/bar", 1e-3 * bar().stiffness_matrix @ np.linspace(2.0, -1.5, 14)),
            1.0,
            np.inf,
        ),
        "tug": (PointVelocity((("load.rim", RAIL),), "load.rim"), 0.4, 200.0),
        "both": (Combination(((0.5, level), (2.0, line))), 0.1, 70.0),
    }
    plain = machine(kind, fidelity)
    given = [
        AppliedForce(f"{name}{more}", "N", measure, gain * size, bandwidth)
        for name, (measure, size, bandwidth) in along.items()
        for more, gain in (("", 1.0), (" scaled", GAIN))
    ]
    return replace(plain, sensors=[*plain.sensors, Given("given", tuple(given))])


PUSHES = {"across": 1.0, "apart": 0.7, "motor": 0.4, "stacks": 0.5, "tug": -0.6, "both": 1.2}
SCALED = {f"{name} scaled": size / GAIN for name, size in PUSHES.items()}


@pytest.mark.parametrize(("kind", "fidelity"), [("resting", "linear"), ("spinning", "ffrf")])
def test_inputs_of_linear_models(kind, fidelity):
    """As signals, and as loads that are constant."""
    scene = pushed(kind, fidelity)
    found = [linearize(scene, constant_inputs=loads) for loads in (PUSHES, SCALED)]
    frf, other = (frequency_response(model, [1.0, 10.0, 150.0]) for model in found)
    assert_same(dict(zip(frf.outputs, other.values, strict=True)), dict(zip(frf.outputs, frf.values, strict=True)))
    for name in PUSHES:
        one, scaled = ({out: frf.response(out, by) for out in frf.outputs} for by in (name, f"{name} scaled"))
        assert_same(scaled, {out: GAIN * response for out, response in one.items()})


def assert_same(found, expected, within=1e-9):
    for name in expected:
        size = np.abs(expected[name]).max() + 1e-3
        np.testing.assert_allclose(found[name], expected[name], rtol=0, atol=within * size, err_msg=name)


@pytest.mark.parametrize(
    ("kind", "fidelity", "method"),
    [
        ("resting", "linear", "exact"),
        ("resting", "linear", "generalized_alpha"),
        ("resting", "ffrf", "generalized_alpha"),
        ("turning", "rigid", "generalized_alpha"),
    ],
)
def test_inputs_of_runs_and_statics(kind, fidelity, method):
    """Of inputs beside constant ones; Newton's iterations leave some 1e-6 of what hardly moves."""
    scene = pushed(kind, fidelity)

    held = {name: 0.3 * size for name, size in PUSHES.items() if name != "motor"}
    scaled = {f"{name} scaled": size / GAIN for name, size in held.items()}
    found, expected = (
        by_name(
            simulate(
                scene,
                signals(scene, 15, sizes),
                constant_inputs=constant,
                time_step=STEP,
                method=method,
                progress=False,
            )
        )
        for sizes, constant in ((SCALED, scaled), (PUSHES, held))
    )
    assert_same(found, {name: expected[name] for name in scene.outputs}, 1e-9 if method == "exact" else 1e-4)
    if method == "exact":
        assert_same(static_response(scene, SCALED), static_response(scene, PUSHES), 1e-6)


@pytest.mark.parametrize("method", ["exact", "generalized_alpha"])
def test_what_an_input_adds_to_an_output_at_once_and_behind_amplifiers_adds_up(method):
    """A force on a spring at rest: in the static response, at 0 Hz and where a constant input has always acted."""
    bodies = RigidBody("ground", {"c": np.zeros(3)}, fixed=True), RigidBody("mass", {"c": np.zeros(3)}, 2.0, np.eye(3))
    level = Displacement.between("ground.c", "mass.c", AXIS)
    added = [Feedthrough("sum", "push", *given) for given in ((2.0,), (-0.5, 80.0), (0.3, 20.0))]
    scene = Scene("mass", bodies, (prismatic("rail", "ground.c", "mass.c", AXIS),),
                  (PointForce("push", "mass.c", AXIS, "push"),), (Given("sum", (Output("sum", "m", level), *added)),),
                  (SpringDamper("spring", "ground.c", "mass.c", AXIS, 1e3),))  # fmt: skip
    expected = CONSTANT * (1e-3 + 1.8)
    assert static_response(scene, {"push": CONSTANT})["sum"] == pytest.approx(expected, rel=1e-9)
    assert frequency_response(linearize(scene), [0.0]).values.item() == pytest.approx(expected / CONSTANT, rel=1e-9)
    nothing = TimeHistory(1e-3 * np.arange(5), np.zeros((1, 5)), ("push",), ("N",))
    options = {"constant_inputs": {"push": CONSTANT}, "time_step": 1e-3, "progress": False}
    np.testing.assert_allclose(simulate(scene, nothing, method=method, **options)["sum"], expected, rtol=1e-9)
