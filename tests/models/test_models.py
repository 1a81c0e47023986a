"""The concrete devices: the APA's dimensions, its cache, the bench."""

import functools

import numpy as np
import pytest
from conftest import make_bar

from models import apa300ml
from models.apa300ml import PORTS, STACK, APAGeometry, axial_stiffness, make_apa300ml, reduced_apa300ml
from models.bench import SENSOR_RESISTANCE, force_pair, formula_frequency, full_bench_response, make_bench
from models.bench_figures import (
    figures_by_circuit,
    gains_of_a_soft_sensor,
    peak_and_dip,
    pole_and_zero,
    pole_zero_level,
    static_gains,
)
from nassim import build_fe_model, frequency_response, linearize
from nassim.fem.assembly import mesh_and_solid


def test_apa_envelope_and_remote_points(apa_solid):
    solid = apa_solid
    low, high = (np.array(tuple(corner)) for corner in solid.shape.bounding_box)
    assert np.allclose(high - low, [78.79e-3, 20e-3, 30e-3], atol=0.02e-3)
    assert [p.name for p in solid.remote_points] == ["bottom", "top", "sensor_end", "junction", "actuator_end"]


def test_apa_faces_lie_under_their_remote_points(apa_solid):
    solid = apa_solid
    for point in solid.remote_points:
        faces = [f for f in solid.shape.faces if f.name in point.faces]
        assert {f.name for f in faces} == set(point.faces)
        centre = np.average([tuple(f.center) for f in faces], axis=0, weights=[f.mass for f in faces])
        assert np.allclose(centre, point.position, atol=1e-9), point.name
    stack_faces = [f for f in solid.shape.faces if f.name == "sensor_stack_end"]
    assert stack_faces[0].mass == pytest.approx(STACK.area, rel=1e-9)


def test_thinner_arms_make_lighter_parts(apa_solid):
    thinner = make_apa300ml(APAGeometry(arm_thickness=1.0e-3))
    assert sum(b.mass for b in thinner.shape.solids) < sum(b.mass for b in apa_solid.shape.solids)


@pytest.mark.parametrize(
    "change", [{"arm_thickness": 0.0}, {"relief": 1.0}, {"pad_fillet": -1e-3}, {"hole_diameter": np.nan}]
)
def test_impossible_dimensions(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must lie between"):
        APAGeometry(**change)


@pytest.mark.parametrize(
    ("name", "low", "high"),
    [
        ("arm_thickness", 0.1e-3, 3e-3),
        ("pad_fillet", 0.05e-3, 0.7e-3),
        ("relief", 0.5e-3, 4.5e-3),
        ("depth", 10e-3, 100e-3),
        ("hole_diameter", 0.5e-3, 8e-3),
    ],
)
def test_dimensions_have_limits(name, low, high):
    for value in (1.1 * low, 0.9 * high):
        APAGeometry(**{name: value})
    for value in (0.9 * low, 1.1 * high):
        with pytest.raises(ValueError, match=f"{name} must lie between {low:g} and {high:g} m"):
            APAGeometry(**{name: value})


def test_reduction_is_cached_and_recomputed_when_an_input_changes(tmp_path, monkeypatch, told):
    """With the mesh of a bar, which takes no time."""
    bar = build_fe_model(make_bar(), element_size=0.02, order=2, progress=False)
    monkeypatch.setattr(apa300ml, "build_fe_model", lambda solid, **_: bar)
    monkeypatch.setattr(apa300ml, "make_apa300ml", functools.cache(make_apa300ml))
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    options = {"element_size": 8e-3, "order": 1, "mesh": {}}
    first = reduced_apa300ml(**options)
    assert "saved to" in told()
    again = reduced_apa300ml(**options)
    loaded = told()
    assert "loaded from" in loaded
    assert "same inputs" in loaded
    assert np.array_equal(first.stiffness_matrix, again.stiffness_matrix)
    assert again.surface.labels == first.surface.labels
    reduced_apa300ml(APAGeometry(arm_thickness=1.3e-3), **options)
    assert "saved to" in told()
    reduced_apa300ml(n_modes=4, **options)
    assert "saved to" in told()
    for file in tmp_path.glob("*.h5"):
        file.write_bytes(file.read_bytes()[:1000])
    rebuilt = reduced_apa300ml(**options)
    assert "damaged and will be rebuilt" in told()
    assert np.allclose(rebuilt.stiffness_matrix, first.stiffness_matrix, rtol=1e-6, atol=1.0)


def test_a_condensed_model_at_hand_is_what_is_reduced(tmp_path, monkeypatch, apa_with_ports, apa_with_ports_condensed):
    """Nothing is meshed again; one of another order or of other ports is refused."""
    reduced = []
    monkeypatch.setattr(apa300ml, "craig_bampton", lambda model, **_: reduced.append(model) or apa_with_ports)
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    options = {"element_size": 8e-3, "order": 2, "ports": PORTS, "mesh": {}, "condensed": apa_with_ports_condensed}
    reduced_apa300ml(**options, progress=False)
    assert reduced == [apa_with_ports_condensed]
    for other in ({"order": 3}, {"ports": PORTS[:1]}):
        with pytest.raises(ValueError, match="build it with the same arguments"):
            reduced_apa300ml(**options | other, progress=False)


def test_bench_names(bench):
    assert bench.inputs == ("actuator_voltage",)
    assert bench.outputs == ("sensor_voltage", "encoder")


def test_bench_without_payload_is_refused(apa):
    with pytest.raises(ValueError, match="mass must be positive"):
        make_bench(0.0, apa=apa)
    with pytest.raises(ValueError, match="known: rigid, linear, ffrf"):
        make_bench(fidelity="modal", apa=apa)


@pytest.mark.parametrize("options", [{"resistance": np.inf}, {"resistance": 5e3, "payload_mass": 7.0}])
def test_bench_frf_equals_the_full_fe_model(apa_with_ports, apa_with_ports_condensed, options):
    """Pole, zero and the whole response by a route without reduction and scene, sensor open and loaded.

    Without damping, which is that of the modes with the sensor open in the one and shorted in the other.
    """
    frequency = np.concatenate([[0.5, 5.0], np.linspace(20.0, 120.0, 2001), [150.0, 400.0]])
    bench = make_bench(apa=apa_with_ports, fidelity="linear", damping_ratio=0.0, **options)
    full = full_bench_response(apa_with_ports_condensed, frequency, damping_ratio=0.0, progress=False, **options)
    linear = frequency_response(linearize(bench), frequency)
    voltage = [np.abs(f.response("sensor_voltage", "actuator_voltage"))[2:-2] for f in (full, linear)]
    for pick in (np.argmax, np.argmin):
        assert pick(voltage[1]) == pick(voltage[0])
    pole, zero = (frequency[2:-2][pick(voltage[0])] for pick in (np.argmax, np.argmin))
    away = (np.abs(frequency / pole - 1) > 0.02) & (np.abs(frequency / zero - 1) > 0.02)
    error = np.abs(linear.values / full.values - 1)
    assert error[..., away].max() < 1e-3
    assert error[..., :2].max() < 1e-6


def test_loaded_sensor_is_the_default_and_an_open_one_the_option(apa_with_ports):
    sensor = make_bench(apa=apa_with_ports).sensors[0]
    assert sensor.resistance == SENSOR_RESISTANCE
    assert make_bench(apa=apa_with_ports, resistance=np.inf).sensors[0].resistance == np.inf
    with pytest.raises(ValueError, match="which the pair of forces does not have"):
        make_bench(apa=apa_with_ports, ports=False, resistance=1e5)


def test_pole_zero_and_gains_by_two_definitions(apa_with_ports):
    """Natural frequencies against what one reads off the FRF; a slow sine against the static solution."""
    model = linearize(make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf))
    found = pole_and_zero(model)
    frf = frequency_response(model, np.linspace(30.0, 110.0, 8001))
    assert peak_and_dip(frf) == pytest.approx(found, rel=1e-3)
    every_quarter_hertz = frequency_response(model, np.arange(30.1, 110.0, 0.25))
    assert peak_and_dip(every_quarter_hertz) == pytest.approx(peak_and_dip(frf), rel=1e-4)
    static = np.abs(model.C @ np.linalg.solve(model.A, model.B[:, 0]))
    gains = static_gains(model)
    assert tuple(gains.values()) == pytest.approx(tuple(static), rel=1e-9)
    # One mode between zero and pole, which joins the static gain to the level beyond: V_s/V_a = level (w_z / w_p)^2.
    level = pole_zero_level(model)["level_between_modes_V_per_V"]
    joined = level * (found["zero_Hz"] / found["pole_Hz"]) ** 2
    assert joined == pytest.approx(gains["static_gain_V_per_V"], rel=0.05)


def test_an_open_sensor_stiffens(apa_with_ports):
    figures = figures_by_circuit(apa_with_ports)
    assert figures["axial_stiffness_shorted_N_per_m"] == axial_stiffness(apa_with_ports)
    stiffer = figures["axial_stiffness_open_N_per_m"] / figures["axial_stiffness_shorted_N_per_m"]
    assert figures["open_over_shorted_pole_percent"] == pytest.approx(100 * (np.sqrt(stiffer) - 1), rel=0.01)
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    pole = pole_and_zero(linearize(bench))["pole_Hz"]
    assert figures["first_eigenfrequency_open_Hz"] == pytest.approx(pole, rel=1e-4)


def test_a_sensor_as_soft_as_shorted_reads_less(apa_with_ports):
    """By less than its coupling stiffens it, k33^2 / 2 of an open stack."""
    bench = make_bench(apa=apa_with_ports, fidelity="linear", resistance=np.inf)
    opened = static_gains(linearize(bench))["static_gain_V_per_V"]
    by_charge, by_ends = gains_of_a_soft_sensor(apa_with_ports)
    assert 1 - STACK.coupling_factor**2 / 2 < by_charge / opened < 1
    # The ends' faces are soft here and dish, so that their elongation is less than the volume's.
    assert by_ends == pytest.approx(by_charge, rel=0.1)


def test_figures_of_the_data_sheets_and_the_paper(apa_with_ports_condensed):
    """Table 1 of the paper; the stack's sheet; which stack does what; the paper's equation 1."""
    steel, ceramic = apa300ml.STEEL, apa300ml.PZT_TABLE_1
    assert (steel.young_modulus, steel.poisson_ratio, steel.density) == (190e9, 0.31, 7800.0)
    assert (ceramic.young_modulus, ceramic.poisson_ratio, ceramic.density) == (49.5e9, 0.31, 7800.0)
    assert (STACK.free_stroke, STACK.blocked_force, STACK.voltage_range) == (20e-6, 4700.0, 170.0)
    assert (STACK.stiffness, STACK.length, STACK.area) == pytest.approx((235e6, 20e-3, 1e-4))
    _, solid = mesh_and_solid(apa_with_ports_condensed.fe_model)
    stacks = ("sensor_stack", "actuator_stack_1", "actuator_stack_2")
    assert {port.name: port.bodies for port in solid.ports} == {"sensor": stacks[:1], "actuator": stacks[1:]}
    assert {name for name, material in solid.materials.items() if material == steel} == {"frame", "spacer"}
    assert {name for name, material in solid.materials.items() if material == apa300ml.PZT} == set(stacks)
    assert formula_frequency(5.0) == pytest.approx(95.3, rel=1e-3)


def test_the_sensors_span_reads_its_force():
    """Ceramic of 20 mm and steel of 5 mm in line, 100 mm2: V = -d F / C, 20 um over 170 V and 20 uF / 3."""
    elongation, force = 1e-6, 1e-6 * 1e-4 / (20e-3 / apa300ml.PZT.young_modulus + 5e-3 / 190e9)
    voltage = -20e-6 / 170 * force / (20e-6 / 3)
    sensor = next(part for part in force_pair() if part.name == "sensor_voltage")
    assert -sensor.voltage_per_elongation * elongation == pytest.approx(voltage, rel=1e-12)


def test_disturbances_of_the_bench_at_rest(apa):
    """A newton on the payload, and the weight of all under a slow acceleration of the ground."""
    model = linearize(make_bench(3.0, "linear", apa=apa, disturbances=True))
    static = (model.D - model.C @ np.linalg.solve(model.A, model.B))[model.outputs.index("encoder")]
    top, n = apa.coordinate_names.index("top.uz"), len(apa.mass_matrix)
    compliance = apa.compliance(fixed=["bottom"], guided={"top": "z"})[top, top]
    assert static[model.inputs.index("payload_force")] == pytest.approx(compliance, rel=1e-8)
    lifted = np.array([float(name.endswith(".uz")) for name in apa.coordinate_names])
    # Of the other points nothing holds the reaction to their inertia but the body itself: statics of its shape.
    moved = np.zeros(n)
    free = np.setdiff1d(np.arange(n), [*range(6), *(k for k in range(6, 12) if k != top)])
    load = -(apa.mass_matrix @ lifted + 3.0 * (np.arange(n) == top))
    moved[free] = np.linalg.solve(apa.stiffness_matrix[np.ix_(free, free)], load[free])
    assert static[model.inputs.index("ground_acceleration")] == pytest.approx(moved[top], rel=1e-8)


def slot_radius(**dimensions):
    """Radius of the round end of the slot beside the stack, the smallest in the frame's outline [mm]."""
    radii = []
    for edge in apa300ml._quarter_outline(APAGeometry(**dimensions)):
        low, high = edge.parameter_interval
        a, b, c = (np.array(tuple(edge.Value(t))) for t in (low, (low + high) / 2, high))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a))
        sides = np.linalg.norm(b - a) * np.linalg.norm(c - b) * np.linalg.norm(a - c)
        radii.append(sides / (4 * area) if area > 1e-9 else np.inf)
    return min(radii)


def test_a_slot_is_open_from_a_twentieth_of_a_millimetre_on():
    """The thicker the arm, the smaller the radius, in proportion."""
    thin, thick = 1.4e-3, 1.5e-3
    slope = (slot_radius(arm_thickness=thick) - slot_radius(arm_thickness=thin)) / (thick - thin)
    wide, narrow = (thin + (share * 0.05 - slot_radius(arm_thickness=thin)) / slope for share in (1.1, 0.9))
    assert slot_radius(arm_thickness=wide) == pytest.approx(1.1 * 0.05, rel=1e-6)
    with pytest.raises(ValueError, match="the slot beside the stack closes"):
        slot_radius(arm_thickness=narrow)
