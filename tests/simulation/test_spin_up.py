"""A flexible arm spun up smoothly by a motor, the manoeuvre of T. R. Kane, R. Ryan, A. Banerjee (1987).

Against a beam of Euler and Bernoulli in the frame that turns with its root, by the closed-form modes of a cantilever:
q'' + (omega^2 - W^2) q = -W' x, each weighted with its mode. Its foreshortening would add W^2 (L^2 - x^2) / 2 times the
square of its slope to the stiffness, more than the W^2 taken off: floating frames leave that out, and say so.
"""

import warnings

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from conftest import make_bar
from scipy.spatial.transform import Rotation

from nassim import (
    Drive,
    Encoder,
    FlexibleBody,
    RigidBody,
    Scene,
    TimeHistory,
    build_fe_model,
    craig_bampton,
    revolute,
    simulate,
)

LENGTH, SIDE = 0.5, 0.005
TURN = Rotation.from_rotvec([0.4, -0.7, 1.1]).as_matrix()
DURATION, RAMP = 0.3, 0.25


@pytest.fixture(scope="module")
def arm():
    solid = make_bar(LENGTH, SIDE)
    return craig_bampton(build_fe_model(solid, element_size=0.02, order=2, progress=False), n_modes=4, progress=False)


def angle(time, speed):
    """Of the root, at its speed after the ramp, from where it goes on evenly; and its two derivatives."""
    t = np.minimum(time, RAMP)
    x = 2 * np.pi * t / RAMP
    turned = speed / RAMP * (t**2 / 2 + (RAMP / (2 * np.pi)) ** 2 * (np.cos(x) - 1)) + speed * (time - t)
    return turned, speed / RAMP * (t - RAMP / (2 * np.pi) * np.sin(x)), speed / RAMP * (1 - np.cos(x))


def spun_up(arm, speed, time_step=5e-4, **options):
    base = RigidBody("base", {"axle": (0, 0, 0)}, fixed=True)
    body = FlexibleBody("arm", arm, rotation=TURN)
    scene = Scene(
        "arm",
        (base, body),
        (revolute("axle", "base.axle", "arm.left", TURN[:, 2]),),
        (Drive("motor", "axle", "rz", "angle"),),
        (Encoder("tip", "arm.left", "arm.right", tuple(TURN[:, 1]), frame="arm.left"),),
        damping_ratio=0.0,
    )
    time = np.arange(round(DURATION / time_step) + 1) * time_step
    history = TimeHistory(time, angle(time, speed)[0][None], ("angle",), ("rad",))
    return simulate(scene, history, time_step=time_step, progress=False, **options)


def beam_tip(time, speed, *, foreshortened=False):
    """Deflection of the tip, by three modes of a cantilever."""
    roots = [scipy.optimize.brentq(lambda b: np.cosh(b) * np.cos(b) + 1, *ends) for ends in ((1, 3), (4, 6), (7, 9))]
    x, weights = np.polynomial.legendre.leggauss(60)
    x, weights = (x + 1) / 2, weights / 2
    modes, slopes, tips = [], [], []
    for b in roots:
        k = (np.cosh(b) + np.cos(b)) / (np.sinh(b) + np.sin(b))

        def shape(x, b=b, k=k):
            return np.cosh(b * x) - np.cos(b * x) - k * (np.sinh(b * x) - np.sin(b * x))

        modes.append(shape(x))
        slopes.append(b * (np.sinh(b * x) + np.sin(b * x) - k * (np.cosh(b * x) - np.cos(b * x))))
        tips.append(shape(1.0))
    modes, slopes, tips = np.array(modes), np.array(slopes), np.array(tips)
    rates = np.array(roots) ** 2 * np.sqrt(200e9 / 7800 * SIDE**2 / 12) / LENGTH**2
    mass = modes @ (weights * modes).T
    stretched = np.linalg.solve(mass, slopes @ (weights * (1 - x**2) / 2 * slopes).T) * foreshortened
    push = np.linalg.solve(mass, modes @ (weights * x)) * LENGTH

    def equation(t, y):
        _, w, a = angle(t, speed)
        q = y[:3]
        return np.concatenate([y[3:], -(rates**2 - w**2) * q - w**2 * stretched @ q - a * push])

    found = scipy.integrate.solve_ivp(
        equation, (0, time[-1]), np.zeros(6), method="DOP853", t_eval=time, rtol=1e-7, atol=1e-10
    )
    return tips @ found.y[:3]


def test_a_slow_spin_up(arm):
    """Where stiffening is negligible: W^2 below a thousandth of the first frequency's square, and no word of it."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        record = spun_up(arm, 3.0)
    expected = beam_tip(record.time, 3.0)
    size = np.abs(expected).max()
    assert size > 1e-3
    assert np.abs(record["tip"] - expected).max() < 1e-3 * size
    assert np.abs(beam_tip(record.time, 3.0, foreshortened=True) - expected).max() < 2e-3 * size


def test_exact_steps_along_a_spin_up(arm):
    """A path through most of a turn whose speed changes: the same beam, in one model of its angle."""
    record = spun_up(arm, 20.0, time_step=1e-3, method="exact")
    expected = beam_tip(record.time, 20.0)
    assert np.abs(record["tip"] - expected).max() < 1e-3 * np.abs(expected).max()


@pytest.mark.filterwarnings("ignore:body 'arm' is deformed")
def test_a_fast_spin_up_is_told(arm):
    """As a beam without foreshortening to 0.2 %, from which one with it is far; the speed comes of an input."""
    with pytest.warns(UserWarning, match=r"'arm' turns at 11\.1 Hz.*: centrifugal stiffening, .* would raise that by"):
        record = spun_up(arm, 70.0)
    expected = beam_tip(record.time, 70.0)
    size = np.abs(expected).max()
    assert np.abs(record["tip"] - expected).max() < 2e-3 * size
    assert np.abs(beam_tip(record.time, 70.0, foreshortened=True) - expected).max() > 0.2 * size
