"""The bench's zero, gains and pole by four routes that share as little as they can, and what sets them apart.

Electrical ports (the default), a pair of forces between remote points (the cheap model), stresses averaged over the
stacks' volume in a full FE model without points, ports or reduction, and a beam model by hand (docs/actuator.md).
"""

import math
from dataclasses import asdict

import numpy as np
from _common import parser, pole_and_zero_of, positive, run, write_summary

from models.apa300ml import PORTS, STACK, reduced_apa300ml
from models.apa300ml.beam_model import axial_stiffness, beam_model, pole_and_zero, static_gains, stroke
from models.apa300ml.stack_volumes import stack_figures
from models.bench import AMPLIFIER_GAIN, BENCH_CONDITIONS, make_bench, sensor_span_constant
from nassim import ReducedBody, Scene, frequency_response, linearize
from nassim.bodies.interface import free_coordinates

arguments = parser(__doc__, "compare_routes")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass on top [kg] (default: 5)")
arguments.add_argument("--coarse", action="store_true", help="meshes of 8 mm and order 2, for a quick look")


def figures_of(scene: Scene) -> dict[str, float]:
    """Zero, pole and static gains of a bench, from its linear model."""
    model = linearize(scene)
    gains = np.abs(frequency_response(model, np.array([1e-6])).values[:, 0, 0])
    pole, zero = pole_and_zero_of(model)
    return {"zero_Hz": zero, "pole_Hz": pole, "sensor_V_per_V": gains[0], "encoder_m_per_V": gains[1]}


def shorted_readings(apa: ReducedBody) -> tuple[float, float]:
    """Static V_s/V_a if the sensor stayed as soft as a shorted one: by its charge, and by its ends' elongation."""
    free = free_coordinates(apa.point_names, **BENCH_CONDITIONS)
    free = np.concatenate([free, np.arange(6 * len(apa.point_names), len(apa.mass_matrix))])
    motion = np.zeros(len(apa.mass_matrix))
    drive = AMPLIFIER_GAIN * apa.port("actuator").forces[free]
    motion[free] = np.linalg.solve(apa.stiffness_matrix[np.ix_(free, free)], drive)
    elongation = (apa.motion("junction") - apa.motion("sensor_end"))[0] @ motion
    charge = apa.port("sensor").forces @ motion
    return float(-charge / STACK.capacitance), float(-sensor_span_constant() * elongation)


def main() -> None:
    args = arguments.parse_args()
    mesh = {"element_size": 8e-3, "order": 2, "mesh": {}} if args.coarse else {}
    ported, plane = reduced_apa300ml(ports=PORTS, **mesh), reduced_apa300ml(stack_coupling="rbe2", **mesh)
    plane_ports = reduced_apa300ml(ports=PORTS, stack_coupling="rbe2", **mesh)
    volumes = stack_figures(
        payload_mass=args.payload_mass, **({"element_size": 8e-3, "order": 2} if args.coarse else {})
    )
    beam = beam_model()
    beam_pole, beam_zero = pole_and_zero(beam, args.payload_mass)
    beam_gains = static_gains(beam)
    options = {"payload_mass": args.payload_mass, "fidelity": "linear"}
    routes = {
        "ports": figures_of(make_bench(apa=ported, resistance=math.inf, **options)),
        "volume_stress": {
            "zero_Hz": volumes.zero,
            "pole_Hz": volumes.pole,
            "sensor_V_per_V": volumes.sensor_gain,
            "encoder_m_per_V": abs(volumes.encoder_gain),
        },
        "pair_of_forces": figures_of(make_bench(apa=plane, **options)),
        "beam_model": {
            "zero_Hz": beam_zero,
            "pole_Hz": beam_pole,
            "sensor_V_per_V": beam_gains[0],
            "encoder_m_per_V": abs(beam_gains[1]),
        },
    }
    reference = routes["ports"]
    print(f"{'sensor open':<18}{'zero [Hz]':>16}{'pole [Hz]':>18}{'V_s/V_a [V/V]':>20}{'d_e/V_a [um/V]':>22}")
    for name, row in routes.items():
        cells = [
            f"{row[key] * factor:{form}} ({100 * (row[key] / reference[key] - 1):+5.1f} %)"
            for key, factor, form in (
                ("zero_Hz", 1, "7.2f"),
                ("pole_Hz", 1, "9.2f"),
                ("sensor_V_per_V", 1, "11.4f"),
                ("encoder_m_per_V", 1e6, "13.2f"),
            )
        ]
        print(f"{name.replace('_', ' '):<17}{''.join(cells)}")
    print("  volumes: tetrahedra, a mesh of their own; pair: reads what a shorted sensor would")

    by_charge, _ = shorted_readings(ported)
    plane_charge, by_ends = shorted_readings(plane_ports)
    steps = {
        "open_over_shorted_sensor": by_charge / reference["sensor_V_per_V"] - 1,
        "plane_faces": plane_charge / by_charge - 1,
        "ends_for_volume": by_ends / plane_charge - 1,
        "forces_for_strain": routes["pair_of_forces"]["sensor_V_per_V"] / by_ends - 1,
    }
    print("\nfrom ports to the pair of forces, static V_s/V_a:")
    for name, change in steps.items():
        print(f"  {name.replace('_', ' '):<28}{100 * change:+6.2f} %")
    mechanics = {
        "ports_axial_stiffness_N_per_m": 1 / ported.compliance(fixed=["bottom"])[8, 8],
        "beam_model_axial_stiffness_N_per_m": axial_stiffness(beam),
        "volume_stress_axial_stiffness_N_per_m": volumes.stiffness,
        "beam_model_stroke_m": stroke(beam),
        "volume_stress_stroke_m": volumes.stroke,
        "beam_model_shorted_zero_Hz": beam_zero,
        "axial_stress_zero_Hz": volumes.axial_zero,
    }
    print("\naxial stiffness, all stacks shorted, and stroke of all three over 170 V:")
    for name in ("volume_stress", "beam_model"):
        k, s = mechanics[f"{name}_axial_stiffness_N_per_m"], mechanics[f"{name}_stroke_m"]
        print(f"  {name.replace('_', ' '):<16}{1e-6 * k:7.3f} N/um {1e6 * s:7.1f} um")
    print(f"zero of the mean axial stress alone, lateral stress unseen: {volumes.axial_zero:.2f} Hz")
    write_summary(
        args.output,
        {
            "payload_mass_kg": args.payload_mass,
            **{f"{route}_{key}": value for route, row in routes.items() for key, value in row.items()},
            **{f"step_{name}": value for name, value in steps.items()},
            **mechanics,
            "beam": asdict(beam),
        },
    )


if __name__ == "__main__":
    run(main)
