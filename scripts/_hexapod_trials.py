"""Decays of the hexapod in time simulations, and the damping of its modes that they show."""

from typing import Any

import numpy as np
from _hexapod import METHODS, SAMPLE_RATE, excite
from scipy.optimize import linear_sum_assignment

from nassim import Scene, TimeHistory, simulate
from nassim.base import decay_poles

POSE = tuple(f"pose.{axis}" for axis in ("ux", "uy", "uz", "rx", "ry", "rz"))
PULSES = ({"payload_force_x": 1.0, "payload_torque_z": 0.1}, {"payload_force_y": 1.0, "payload_force_z": 1.0})
"""Pushes on the payload [N], [N m] that together excite all modes, and those that come in pairs not alike."""
PULSE_TIME, PULSE_WIDTH, PULSE_END = 0.01, 0.002, 0.02
"""When they are largest, how long they take and from when the payload is left alone [s]."""
EVERY, N_POLES = 8, 40
"""Samples that make one of the decays' poles are found from, and how many these are."""
TRIALS = {
    "least predicted": "least_predicted:.4f",
    "simulated": "least_simulated:.4f",
    "most predicted": "most_predicted:.4f",
    "simulated ": "most_simulated:.4f",
    "largest difference [%]": "largest_difference_percent:.2f",
    "us a step": "us_per_step:.0f",
}
"""Columns that print what `trial` gives: of the least and the most damped of six modes, and the largest difference."""


def decay(scene: Scene, pulse: dict[str, float], *, method: str, duration: float) -> TimeHistory:
    """The payload's pose after a push."""
    time = np.arange(round(duration * SAMPLE_RATE) + 1) / SAMPLE_RATE
    shape = np.exp(-(((time - PULSE_TIME) / PULSE_WIDTH) ** 2))
    excitation = excite(scene, time, {name: size * shape for name, size in pulse.items()})
    record = simulate(
        scene, excitation, time_step=1 / SAMPLE_RATE, outputs=POSE, method=METHODS[method][1], progress=False
    )
    return record.select(POSE)


def trial(records: list[TimeHistory], predicted: np.ndarray) -> dict[str, Any]:
    """Frequencies [Hz] and damping ratios of predicted poles, (6,), and of the same modes in records of decays."""
    decays = np.array([record.after(PULSE_END).values[:, ::EVERY] for record in records])
    poles = decay_poles(decays, EVERY / SAMPLE_RATE, n_poles=N_POLES)
    rows, columns = linear_sum_assignment(np.abs(predicted[:, None] - poles))
    found = poles[columns[np.argsort(rows)]]
    expected, simulated = (-poles.real / np.abs(poles) for poles in (predicted, found))
    return {
        "damping_predicted": expected,
        "damping_simulated": simulated,
        "frequency_predicted_Hz": np.abs(predicted) / (2 * np.pi),
        "frequency_simulated_Hz": np.abs(found) / (2 * np.pi),
        "least_predicted": expected.min(),
        "most_predicted": expected.max(),
        "least_simulated": simulated.min(),
        "most_simulated": simulated.max(),
        "largest_difference_percent": 100 * np.abs(simulated / expected - 1).max(),
    }
