"""A bench with random parameters, records of it, and errors of the parameters that are identified from them."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from models.apa300ml import COARSE, reduced_apa300ml
from models.bench import make_bench
from nassim import FlexibleBody, Joint, ReducedBody, RigidBody, Scene, TimeHistory, simulate
from nassim.identification import ModalFit, UpdateReport, modal_gains
from nassim.signals import band_limited_noise, write_record
from nassim.simulation import assemble

SAMPLE_RATE, CUTOFF_FREQUENCY = 10e3, 500.0  # Hz
LIMITS = {  # drawn evenly between these
    "payload_mass_kg": (3.9, 4.3),
    "fixture_mass_kg": (0.5, 0.8),
    "damping_ratio_1": (0.005, 0.02),
    "damping_ratio_2": (0.005, 0.02),
    "actuator_factor": (0.8, 1.2),
    "sensor_factor": (0.8, 1.2),
}


def against_truth(fit: ModalFit, report: UpdateReport, truth: Mapping[str, float]) -> dict[str, dict[str, float]]:
    """Return fitted parameters by their names in the truth, with errors in percent and in standard deviations."""
    fitted, std = {}, {}
    for k in range(min(2, len(fit.frequency))):
        names = (f"frequency_{k + 1}_Hz", f"damping_ratio_{k + 1}")
        fitted |= zip(names, (fit.frequency[k], fit.damping_ratio[k]), strict=True)
        std |= zip(names, (fit.frequency_std[k], fit.damping_ratio_std[k]), strict=True)
        for output, unit in (("sensor_voltage", "V_per_V"), ("encoder", "m_per_V")):
            name, row = f"{output}_gain_{k + 1}_{unit}", fit.outputs.index(output)
            fitted[name], std[name] = fit.gains[row, k], fit.gains_std[row, k]
    for change in report.changes[-2:]:  # one actuator, one sensor besides the encoder
        name = f"{change.parameter.partition('_')[0]}_factor"
        fitted[name], std[name] = change.after / change.before, change.std / abs(change.before)
    return {
        "fitted": fitted,
        "errors_in_percent": {name: 100 * (value / truth[name] - 1) for name, value in fitted.items()},
        "errors_over_std": {name: (value - truth[name]) / std[name] for name, value in fitted.items()},
    }


def blind_scene(seed: int, apa: ReducedBody) -> tuple[Scene, dict[str, float]]:
    """Make the bench with random parameters and a second resonance; return it and the parameters."""
    random = np.random.default_rng(seed)
    truth = {name: float(random.uniform(*limits)) for name, limits in LIMITS.items()}
    bench = make_bench(truth["payload_mass_kg"], "linear", apa=apa)
    base, lower, payload = bench.bodies
    top = bench.point_position("apa.top")
    payload = replace(payload, points={**payload.points, "top": top - payload.position})
    bottom, above = (apa.point(name).position for name in ("bottom", "top"))
    end = top + above - bottom
    mass = truth["fixture_mass_kg"]
    fixture = FlexibleBody("fixture", apa, position=top - bottom, fidelity="linear", frame="bottom")
    load = RigidBody("load", {"bottom": np.zeros(3)}, mass, 1e-3 * mass * np.eye(3), position=end)
    base = replace(base, points={**base.points, "upper_guide": end})
    joints = (
        Joint("fixture_mount", "payload.top", "fixture.bottom"),
        Joint("load_mount", "fixture.top", "load.bottom"),
        Joint("upper_guide", "base.upper_guide", "load.bottom", free=("z",)),
    )
    (actuator,), (sensor, encoder) = bench.actuators, bench.sensors
    actuator = replace(actuator, gain=actuator.gain * truth["actuator_factor"])
    sensor = replace(sensor, voltage_per_elongation=sensor.voltage_per_elongation * truth["sensor_factor"])
    scene = replace(
        bench,
        bodies=(base, lower, payload, fixture, load),
        joints=(*bench.joints, *joints),
        actuators=(actuator,),
        sensors=(sensor, encoder),
        damping_ratio=[truth["damping_ratio_1"], truth["damping_ratio_2"], 0.01],
    )
    assembly = assemble(scene)
    gains = modal_gains(assembly)[:, 0]
    for k in range(2):
        truth[f"frequency_{k + 1}_Hz"] = float(assembly.modal.frequency[k])
        truth[f"sensor_voltage_gain_{k + 1}_V_per_V"] = float(gains[0, k])
        truth[f"encoder_gain_{k + 1}_m_per_V"] = float(gains[1, k])
    return scene, truth


def make_blind_record(folder: Path, *, seed: int, noise: float, duration: float) -> tuple[Path, dict[str, float]]:
    """Write record.csv into a folder; return its path and the truth. noise: rms over that of the signal."""
    apa = reduced_apa300ml(**COARSE)
    scene, truth = blind_scene(seed, apa)
    excitation = band_limited_noise(duration, SAMPLE_RATE, cutoff_frequency=CUTOFF_FREQUENCY, rms=0.1, seed=seed)
    record = simulate(scene, excitation, time_step=1 / SAMPLE_RATE, method="exact", hold_order=0, progress=False)
    values = record.values.copy()
    random = np.random.default_rng([seed, 1])
    values[1:] += noise * values[1:].std(axis=1, keepdims=True) * random.standard_normal(values[1:].shape)
    return write_record(TimeHistory(record.time, values, record.names, record.units), folder / "record.csv"), truth
