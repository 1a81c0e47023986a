"""The concrete parts: the APA's dimensions, its cache, the bench."""

import numpy as np
import pytest

from models.apa300ml import STACK, APAGeometry, make_apa300ml, reduced_apa300ml
from models.bench import BENCH_CONDITIONS, bench_forces_and_readings, make_bench
from nassim import frequency_response, linearize
from nassim.fullmodel import full_frequency_response


def test_apa_envelope_and_remote_points():
    solid = make_apa300ml()
    low, high = (np.array(tuple(corner)) for corner in solid.shape.bounding_box)
    assert np.allclose(high - low, [78.79e-3, 20e-3, 30e-3], atol=0.02e-3)
    assert [p.name for p in solid.remote_points] == ["bottom", "top", "sensor_end", "junction", "actuator_end"]


@pytest.mark.parametrize("coupling", ["rbe2", "rbe3"])
def test_apa_faces_lie_under_their_remote_points(coupling):
    solid = make_apa300ml(coupling=coupling)
    for point in solid.remote_points:
        faces = [f for f in solid.shape.faces if f.name in point.faces]
        assert {f.name for f in faces} == set(point.faces)
        centre = np.average([tuple(f.center) for f in faces], axis=0, weights=[f.mass for f in faces])
        assert np.allclose(centre, point.position, atol=1e-9), point.name
    stack_faces = [f for f in solid.shape.faces if f.name == "sensor_stack_end"]
    assert stack_faces[0].mass == pytest.approx(STACK.area, rel=1e-9)


def test_thinner_arms_make_lighter_parts():
    masses = [
        sum(b.mass for b in make_apa300ml(APAGeometry(arm_thickness=t)).shape.solids) for t in (1.0e-3, 1.4e-3, 1.6e-3)
    ]
    assert masses == sorted(masses)


@pytest.mark.parametrize(
    "change", [{"arm_thickness": 0.0}, {"relief": 1.0}, {"pad_fillet": -1e-3}, {"hole_diameter": np.nan}]
)
def test_impossible_dimensions(change):
    with pytest.raises(ValueError, match=f"{next(iter(change))} must lie between"):
        APAGeometry(**change)


def test_reduction_is_cached_and_recomputed_when_an_input_changes(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("NASSIM_CACHE", str(tmp_path))
    options = {"element_size": 8e-3, "order": 1, "mesh": {}}
    first = reduced_apa300ml(**options)
    assert "saved to" in capsys.readouterr().out
    again = reduced_apa300ml(**options)
    out = capsys.readouterr().out
    assert "loaded from" in out
    assert "same inputs" in out
    assert np.array_equal(first.stiffness_matrix, again.stiffness_matrix)
    assert again.surface.labels == first.surface.labels
    reduced_apa300ml(APAGeometry(arm_thickness=1.3e-3), **options)
    assert "saved to" in capsys.readouterr().out
    reduced_apa300ml(n_modes=4, **options)
    assert "saved to" in capsys.readouterr().out
    for file in tmp_path.glob("*.h5"):
        file.write_bytes(file.read_bytes()[:1000])
    rebuilt = reduced_apa300ml(**options)
    assert "damaged and will be rebuilt" in capsys.readouterr().out
    assert np.allclose(rebuilt.stiffness_matrix, first.stiffness_matrix, rtol=1e-6, atol=1.0)


def test_bench_names(bench):
    assert bench.inputs == ("actuator_voltage",)
    assert bench.outputs == ("sensor_voltage", "encoder")


def test_bench_without_payload_is_refused(apa):
    with pytest.raises(ValueError, match="mass must be positive"):
        make_bench(0.0, apa=apa)
    with pytest.raises(ValueError, match="known: rigid, linear, ffrf"):
        make_bench(fidelity="modal", apa=apa)


def test_bench_frf_equals_the_full_fe_model(bench, apa_condensed):
    """First pole and first zero within 0.5 %, the whole response close, by a route that shares no scene code."""
    frequency = np.linspace(20.0, 120.0, 4001)
    inputs, outputs = bench_forces_and_readings()
    full = full_frequency_response(
        apa_condensed,
        frequency,
        inputs=inputs,
        outputs=outputs,
        damping_ratio=0.01,
        masses={"top": 5.0},
        progress=False,
        **BENCH_CONDITIONS,
    ).frf
    linear = frequency_response(linearize(bench), frequency)
    voltage = [np.abs(f.response("sensor_voltage", "actuator_voltage")) for f in (full, linear)]
    for pick in (np.argmax, np.argmin):
        assert frequency[pick(voltage[1])] == pytest.approx(frequency[pick(voltage[0])], rel=5e-3)
    assert np.abs(linear.values / full.values - 1).max() < 0.02
