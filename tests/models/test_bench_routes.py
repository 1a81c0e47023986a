"""The bench by routes that share neither code nor definitions: ports, pair of forces, volumes, beams by hand."""

import numpy as np
import pytest
from conftest import meshed

from models.apa300ml import PORTS, VENDOR_STIFFNESS, VENDOR_STROKE, make_apa300ml, reduced_apa300ml
from models.apa300ml.beam_model import axial_stiffness, beam_model, pole_and_zero, static_gains, stroke
from models.apa300ml.stack_volumes import stack_figures
from models.bench import make_bench
from nassim import craig_bampton, linearize
from nassim.systems.state_space import transmission_zeros


def zero_of(scene):
    """Zero of V_s/V_a between 20 and 60 Hz [Hz]."""
    model = linearize(scene)
    a, b, c, d = model.matrices
    zeros = transmission_zeros((a, b[:, :1], c[:1], d[:1, :1]))
    found = np.abs(zeros[zeros.imag > 0]) / (2 * np.pi)
    (result,) = found[(found > 20.0) & (found < 60.0)]
    return float(result)


def static_of(scene):
    """Static V_s/V_a [V/V] and d_e/V_a [m/V]."""
    model = linearize(scene)
    return -model.C @ np.linalg.solve(model.A, model.B[:, 0])


@pytest.fixture(scope="module")
def ports():
    """The bench by ports, sensor open, on the default mesh."""
    apa = reduced_apa300ml(ports=PORTS, progress=False)
    return make_bench(apa=apa, fidelity="linear", resistance=np.inf, damping_ratio=0.0)


@pytest.mark.slow
def test_pair_of_forces_is_near_the_ports(ports, apa_prisms):
    """As cheap as it is, the pair keeps zero and gain: its points lie on the right faces, which stay plane."""
    plane = craig_bampton(meshed(apa_prisms, make_apa300ml(stack_coupling="rbe2"), 3), progress=False)
    pair = make_bench(apa=plane, fidelity="linear", damping_ratio=0.0)
    assert zero_of(pair) == pytest.approx(zero_of(ports), rel=0.02)
    assert static_of(pair)[0] == pytest.approx(static_of(ports)[0], rel=0.08)
    assert static_of(pair)[1] == pytest.approx(static_of(ports)[1], rel=0.04)


@pytest.mark.slow
def test_stresses_in_the_volumes_confirm_the_ports(ports):
    """A full model of its own mesh, without points, ports, reduction and scene."""
    volumes = stack_figures()
    assert volumes.zero == pytest.approx(zero_of(ports), rel=0.015)
    assert (volumes.sensor_gain, volumes.encoder_gain) == pytest.approx(static_of(ports), rel=0.025)
    first = np.sqrt(np.sort(np.linalg.eigvals(linearize(ports).A @ linearize(ports).A).real)[-1] * -1) / (2 * np.pi)
    assert volumes.pole == pytest.approx(first, rel=0.005)
    assert volumes.stiffness == pytest.approx(VENDOR_STIFFNESS, rel=0.01)


@pytest.mark.slow
def test_beams_by_hand_confirm_the_zero(ports):
    model = beam_model()
    _, zero = pole_and_zero(model)
    assert zero == pytest.approx(zero_of(ports), rel=0.15)
    gains = static_gains(model)
    assert gains == pytest.approx(static_of(ports), rel=0.2)


def test_beams_by_hand_give_the_published_figures():
    """Vendor's stiffness, the literature's stroke, the paper's frequency: nothing of it went into the model."""
    model = beam_model()
    assert axial_stiffness(model) == pytest.approx(VENDOR_STIFFNESS, rel=0.05)
    assert stroke(model) == pytest.approx(VENDOR_STROKE, rel=0.15)
    shorted = np.sqrt(axial_stiffness(model) / 5.0) / (2 * np.pi)
    assert shorted == pytest.approx(95.9, rel=0.02)
    pole, zero = pole_and_zero(model)
    assert zero < shorted < pole
