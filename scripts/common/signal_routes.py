"""Timed work on signals, with limits, peers and differences of their results."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import scipy

from common.limits import bare_product
from nassim import Loop, Scene, TimeHistory, estimate_frf, identify_modes, linearize, simulate
from nassim.signals.time_history import fast_length
from nassim.systems import integral_force_feedback

RATE, SEGMENT, EXCITED = 10e3, 10_000, 250
"""Sample rate [Hz], samples of a segment, and excited lines."""
SIGNALS: dict[str, Any] = {"input": "actuator_voltage", "outputs": ("sensor_voltage", "encoder")}


@dataclass(frozen=True)
class Row:
    """Work of some size, its limit and its peer, if any; difference: of their results."""

    size: int
    work: Callable[[], Any]
    limit: Callable[[], Any]
    peer: Callable[[], Any] | None
    difference: Callable[[Any, Any], float]


def deviation(ours: Any, peers: Any) -> float:
    """Return the largest difference as a share of the largest value."""
    return float(np.abs(ours - peers).max() / np.abs(peers).max())


def stepping(bench: Scene, noise: TimeHistory) -> dict[str, Row]:
    """Time exact steps of the bench: without a loop beside SciPy, and with one beside steps sample by sample."""

    def stepped(scene: Scene) -> Any:
        return simulate(scene, noise, time_step=1 / RATE, method="exact", progress=False)["encoder"]

    model, n = linearize(bench), len(noise.time)
    product = bare_product(len(model.A), 1, 2, n)
    iff = Loop("iff", integral_force_feedback(20.0, sample_rate=RATE), SIGNALS["outputs"][0], SIGNALS["input"])
    looped, sampled = (replace(bench, loops=(replace(iff, input_step=step),)) for step in (0.0, 1e-13))

    def scipys() -> Any:
        return scipy.signal.lsim(model.matrices, noise.values[0], noise.time)[1][:, 1]

    return {
        "exact": Row(n, partial(stepped, bench), product, scipys, deviation),
        "exact, loop": Row(n, partial(stepped, looped), product, partial(stepped, sampled), deviation),
    }


def estimation(record: TimeHistory) -> Row:
    """Time FRFs of the bench from a record; the limit is the Fourier transform of its segments."""
    u, y = record[SIGNALS["input"]], record.select(SIGNALS["outputs"]).values
    cross = partial(scipy.signal.csd, fs=RATE, nperseg=SEGMENT)

    def ours() -> Any:
        outputs = SIGNALS["outputs"]
        frf = estimate_frf(record, inputs=[SIGNALS["input"]], outputs=outputs, segment_duration=SEGMENT / RATE)
        return frf.values[:, 0, :EXCITED] / np.abs(frf.values[:, 0]).max(axis=1, keepdims=True)

    def scipys() -> Any:
        frf = (cross(u, y)[1] / cross(u, u)[1])[:, 1 : EXCITED + 1]
        return frf / np.abs(frf).max(axis=1, keepdims=True)

    segments = record.values[:, : len(u) // SEGMENT * SEGMENT].reshape(-1, SEGMENT)
    return Row(len(u), ours, lambda: [scipy.fft.rfft(segments) for _ in range(2)], scipys, deviation)


def identification(record: TimeHistory) -> Row:
    """Time identification of the bench's mode from a record with 1 % noise; the limit transforms its signals."""
    random = np.random.default_rng(1)
    noise = random.normal(size=record.values.shape) * record.values.std(axis=1, keepdims=True)
    noisy = replace(record, values=record.values + 0.01 * noise * [[0.0], [1.0], [1.0]])
    n = fast_length(len(record.time))

    def ours() -> Any:
        return identify_modes(noisy, **SIGNALS, band=(20.0, 300.0), hold_order=1, n_modes=1)

    return Row(
        n,
        ours,
        lambda: scipy.fft.rfft(noisy.values[:, :n]),
        None,
        lambda fit, _: float(abs(fit.damping_ratio[0] - 0.01) / fit.damping_ratio_std[0]),
    )
