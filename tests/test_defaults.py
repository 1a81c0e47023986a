"""Defaults of public functions and data classes: an argument of one name has one default, with few exceptions."""

import importlib
import inspect
from dataclasses import MISSING, fields, is_dataclass
from math import inf, nan
from typing import Any

import numpy as np
from arguments import optional_arguments

from nassim.lazy_names import PACKAGES

IDENTITY = np.eye(3)
USUAL = (
    ("", "a axes_of cad_body colour component description frame input plan text"),
    (False, "allow_unstable angular any_coordinates any_size continuous geometric_stiffness inertial mesh noise"),
    (False, "of_strain rigid several"),
    (True, "binaries checked enabled full_integrals loaded period_correction progress relative shape"),
    (True, "tetrahedra_instead turning"),
    (0, "capacitance constant corner_frequency damping derivative digits endurance_limit high_pass hold_order"),
    (0, "input_step integral_frequency kd ki low_pass_frequency output_step prewarp ramp_time rise_time seed"),
    (0, "stiffness trusted_until"),
    ((0, 0, 0), "angular_velocity axis_point centre gravity point position"),
    (1, "amplitude delay gain magnification n_settling order rms spectral_radius times"),
    (inf, "bandwidth bending input_limit limit max_time resistance"),
    (nan, "mesh_error norm"),
    (IDENTITY, "axes rotation"),
    ("z", "axis normal"),
    (4, "delay_order"),
    (0.5, "curvature overlap"),
    (0.1, "distance largest_deviation"),
    (5, "factor n_spots"),
    (300, "frames"),
    (200, "max_solves"),
    (300_000, "max_unknowns"),
    (2, "n_periods"),
    (500, "n_resamples"),
    (0.95, "confidence"),
    (0.9, "coverage"),
    (0.99, "power_fraction"),
    (-0.45, "transverse_ratio"),
    (1e-3, "tolerance"),
    ((0, 1, 2, 3), "residual_powers"),
    ((0.435, -0.819, 0.375), "camera"),
    ((1200, 900), "size"),
    ("V", "unit"),
    ("rbe3", "coupling"),
    ("ffrf", "fidelity"),
    ("generalized_alpha", "method"),
    ("equilibrium", "start"),
    ("start", "stress"),
    ("co_simulation", "interface"),
    ("2.0", "version"),
    ("double", "precision"),
    ("arrays", "source"),
    ("hann", "window"),
)
"""Defaults, and names of the arguments that have them; all other names have None or what is empty."""
OTHERS: dict[str, dict[str, Any]] = {
    "axes": {"Mark block": None},
    "axis": {"Face OnCylinder": None},
    "component": {"SpringForce": "value"},
    "corner_frequency": {"Geophone": 4.5},
    "damping": {"Bushing": (0,) * 6},
    "damping_ratio": {"Accelerometer": 0.02, "Geophone": 0.7, "body_state_space export_body": 0},
    "delay": {"identify_modes": 0},
    "direction": {"ElectricalPort": (1, 0, 0), "Drive": ""},
    "error": {"MeshRound": nan},
    "fixed": {"RigidBody": False},
    "frame": {
        "FlexibleBody View.displacement save_picture": None,
        "linearize linearize_closed spinning_equilibrium": "rotor",
    },
    "frames": {"mode_motion": 48},
    "gravity": {"joined": None, "static_motion": True},
    "held": {"Constraint": ("value",)},
    "hold": {"controller_response": False, "loop_response": True},
    "hold_order": {"Simulation simulate simulate_motion identify_modes": None},
    "label": {
        "FRF estimate_frf": "",
        "read_frf": "recorded",
        "controller_response": "controller",
        "frequency_response": "linear model",
        "loop_response open_loop": "open loop",
        "ModalFit.response": "fit",
        "block": "block",
        "cylinder": "cylinder",
    },
    "limit": {"plot_noise_budget": None},
    "loaded": {"exudyn_eigenfrequencies": False},
    "method": {"estimate_frf": "H1", "damage_rate": "dirlik", "export_fmu": "exact"},
    "modulus": {"plot_nyquist": 0.5},
    "n": {
        "compare view_modes": 6,
        "build_fe_model": 5,
        "full_eigenfrequencies": 10,
        "buckling_factors view_buckling": 1,
        "view_scene_modes": 12,
    },
    "n_modes": {"read_calculix": 6},
    "name": {
        "band_limited_noise chirp multisine sine_dwell step": "actuator_voltage",
        "recorded_budget": "record",
        "weighting_filter": "weight",
        "Face glue": "",
        "StressSurface": "stress",
        "superelement": "superelement",
    },
    "noise": {"Loop": None},
    "order": {"low_pass": 4, "FEModel": 0, "build_fe_model": None},
    "place": {"view_stress view_stress_motion": "stress"},
    "position": {"PeakStress": None},
    "preload": {"SpringDamper": 0, "Bushing": (0,) * 6},
    "rotation": {"RelativePose": "vector", "placed Assembly": None},
    "seed": {"sweep": None},
    "shaft": {"RelativePose": (0,) * 3},
    "spectral_radius": {"export_fmu Simulation simulate simulate_motion": None},
    "speed": {"PrescribedMotion": 0},
    "start": {"step": 0},
    "stiffness": {"PiezoStack.from_datasheet": None},
    "stress": {"craig_bampton LoadedState": None, "loaded_state": True},
    "tolerance": {
        "build_fe_model craig_bampton": None,
        "hinf_norm": 1e-6,
        "full_frequency_response": 1e-8,
        "stress_convergence": 0.05,
    },
    "unit": {"stage plot_tornado": "", "face_table read_solid": "mm"},
    "units": {"Superelement superelement": "m-N-kg"},
}
"""Names of arguments that have other defaults in some functions and data classes; there, None is also what is empty."""


def default(verb: Any, name: str) -> Any:
    """Default of an argument, that of a list or an array in a data class too."""
    made = [f.default_factory for f in fields(verb) if f.name == name] if is_dataclass(verb) else []
    return made[0]() if made and made[0] is not MISSING else inspect.signature(verb).parameters[name].default


def text(value: Any) -> str:
    """A default in one writing, None for all that stands for what a call finds."""
    if isinstance(value, bool | str) or (isinstance(value, tuple) and value and isinstance(value[0], str)):
        return repr(value)
    number = isinstance(value, int | float) or (isinstance(value, tuple | np.ndarray) and np.size(value))
    return repr(np.asarray(value, float).tolist() if number else None)


def test_an_argument_has_the_default_of_its_name():
    usual = {name: text(value) for value, names in USUAL for name in names.split()}
    others = {
        f"{verb}: {name}": text(value)
        for name, values in OTHERS.items()
        for verbs, value in values.items()
        for verb in verbs.split()
    }
    found, expected = {}, {}
    for package in map(importlib.import_module, PACKAGES[1:]):
        for case in optional_arguments(package):
            verb, name = case.split(": ")
            public, _, method = verb.partition(".")
            item = getattr(package, public)
            found[case] = text(default(getattr(item, method) if method else item, name))
            expected[case] = others.get(case, usual.get(name, "None"))
    assert {case: one for case, one in found.items() if one != expected[case]} == {}
    assert others.keys() <= found.keys()
    assert usual.keys() <= {case.split(": ")[1] for case in found.keys() - others.keys()}
    assert [case for case, one in others.items() if one == usual.get(case.split(": ")[1], "None")] == []
