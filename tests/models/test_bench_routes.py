"""The bench by routes that share neither code nor definitions: ports, pair of forces, volumes, beams by hand."""

import numpy as np
import pytest
from conftest import meshed
from scipy.integrate import trapezoid

from models.apa300ml import (
    PORTS,
    PZT,
    VENDOR_STIFFNESS,
    VENDOR_STROKE,
    APAGeometry,
    make_apa300ml,
    reduced_apa300ml,
)
from models.apa300ml.beam_model import SLOPE, axial_stiffness, beam_model, pole_and_zero, static_gains, stroke
from models.apa300ml.stack_volumes import stack_figures
from models.bench import make_bench
from models.two_mass import APA300ML
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


def test_arms_by_hand_are_soft_across_and_stiff_along_their_slope():
    """A projector on the arm's axis has no direction across whose sign could be wrong."""
    model = beam_model()
    along = np.array([np.cos(SLOPE), -np.sin(SLOPE)])  # from the pad outwards and down to the end block
    arm = model.bending * np.eye(2) + (model.stretching - model.bending) * np.outer(along, along)
    ends = np.diag([1.0, -1.0])  # the block moves outwards, from the arm's end; the pad rises, at its begin
    whole = 4 * ends @ arm @ ends + np.diag([4 * model.line, 0.0])
    rise = np.linalg.solve(whole, [0.0, 2.0])[1]  # a newton pulls at each pad
    assert axial_stiffness(model) == pytest.approx(1 / (2 * rise), rel=1e-9)


def test_gains_by_hand_are_near_those_of_three_springs():
    """Signs too: stacks that lengthen press on the sensor, which reads positive then, and draw the pads together."""
    a = APA300ML
    springs = [[a.sensor + a.drive, -a.drive], [-a.drive, a.drive + a.shell]]
    middle, upper = np.linalg.solve(springs, 20.0 * a.force_per_volt * np.array([-1.0, 1.0]))
    assert static_gains(beam_model()) == pytest.approx((a.voltage_per_elongation * middle, upper), rel=0.2)
    assert static_gains(beam_model())[0] > 0 > static_gains(beam_model())[1]


def test_a_heavier_payload_lowers_both_by_the_whole_mass():
    """What moves with it is that of the finite elements, to 5 %."""
    light, heavy = (np.array(pole_and_zero(beam_model(), payload_mass)) for payload_mass in (0.5, 5.0))
    moving = (5.0 - 0.5 * (light / heavy) ** 2) / ((light / heavy) ** 2 - 1)
    assert moving == pytest.approx(APA300ML.upper_mass, rel=0.06)


def test_arms_are_longer_by_what_their_roots_turn():
    """O'Donnell's turn of a root, 5.3 (1 - nu^2) M / (E b t^2), over M / E I of a beam, I = b t^3 / 12."""
    straight = (32.5e-3 + 3.5e-3 - 4.5e-3) / np.cos(np.radians(9.98))
    root = 5.3 * (1 - 0.31**2) / 12 * 1.4e-3
    assert beam_model(APAGeometry(arm_thickness=1.4e-3, relief=3.5e-3)).arm_length == pytest.approx(
        straight + 2 * root, rel=1e-4
    )


def test_an_end_block_bends_and_shears_as_a_short_beam():
    """By unit loads, integrated: supports where the arms pull, the stack's pressure over 10 mm, read in the middle."""
    geometry = APAGeometry(arm_thickness=1.4e-3, relief=3.5e-3)
    reach = 12.06e-3 - (32.5e-3 + 3.5e-3 - 4.5e-3) * np.tan(np.radians(9.98))
    height, depth, half, young = 39.397e-3 - 32.5e-3, 20e-3, 5e-3, 190e9
    x = np.linspace(0.0, reach, 200_001)  # from one support to the middle
    shear = np.minimum(1.0, (reach - x) / half) / 2
    moment = np.concatenate([[0.0], np.cumsum((shear[1:] + shear[:-1]) / 2 * np.diff(x))])
    bend = 2 * trapezoid(moment * x / 2, x) / (young * depth * height**3 / 12)
    slide = 2 * 1.2 * trapezoid(shear / 2, x) / (young / (2 * 1.31) * depth * height)
    span, spacer = PZT.young_modulus * 1e-4 / 20e-3, young * 1e-4 / 5e-3
    line = 1 / (3 / span + 1 / spacer + 2 * (bend + slide))
    assert beam_model(geometry).line == pytest.approx(line, rel=1e-6)
    assert slide > 0.2 * bend
