"""Compute the bench's zero, gains and pole by four independent routes, and explain the differences.

The routes are electrical ports (the default), a pair of forces between remote points (the simpler model), stresses
averaged over the volume of the stacks in a full FE model without points, ports or reduction, and a beam model by hand
(docs/actuator.md).
"""

import math
from dataclasses import asdict

from common.arguments import parser, positive, run
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from models.apa300ml import COARSE, PORTS, axial_stiffness, beam_model, reduced_apa300ml
from models.apa300ml.stack_volumes import stack_figures
from models.bench import make_bench
from models.bench_figures import gains_of_a_soft_sensor, pole_and_zero, static_gains
from nassim import Scene, linearize

arguments = parser(__doc__, "compare_routes")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass of the payload [kg] (default: 5)")
arguments.add_argument("--coarse", action="store_true", help="meshes of 8 mm, order 2, for a quick look")

COLUMNS = {
    "zero [Hz]": "zero_Hz:.2f",
    "pole [Hz]": "pole_Hz:.2f",
    "V_s/V_a [V/V]": "sensor_V_per_V:.4f",
    "d_e/V_a [um/V]": "encoder_m_per_V*1e6:.2f",
}
REPORT = """volumes: tetrahedra, a mesh of their own; pair: reads what a shorted sensor would

from ports to the pair of forces, static V_s/V_a:
  sensor open, not shorted                     {step_open_over_shorted_sensor*100:+.2f} %
  plane faces at the remote points             {step_plane_faces*100:+.2f} %
  elongation of the ends, not of the volume    {step_ends_for_volume*100:+.2f} %
  forces at the ends, not strain of the volume {step_forces_for_strain*100:+.2f} %
axial stiffness, all stacks shorted, and stroke of all three over 170 V:
  volume stress {volume_stress_axial_stiffness_N_per_m*1e-6:.3f} N/um, {volume_stress_stroke_m*1e6:.1f} um
  beam model    {beam_model_axial_stiffness_N_per_m*1e-6:.3f} N/um, {beam_model_stroke_m*1e6:.1f} um
zero of the mean axial stress alone, lateral stress unseen: {axial_stress_zero_Hz:.2f} Hz
"""


def main() -> None:
    args = arguments.parse_args()
    mesh = COARSE if args.coarse else {}
    ported, plane = reduced_apa300ml(ports=PORTS, **mesh), reduced_apa300ml(stack_coupling="rbe2", **mesh)
    plane_ports = reduced_apa300ml(ports=PORTS, stack_coupling="rbe2", **mesh)
    options = {"payload_mass": args.payload_mass, "fidelity": "linear"}
    volumes = stack_figures(payload_mass=args.payload_mass, **{k: v for k, v in mesh.items() if k != "mesh"})
    beam = beam_model.beam_model()
    beam_pole, beam_zero = beam_model.pole_and_zero(beam, args.payload_mass)
    routes = {
        "ports": figures_of(make_bench(apa=ported, resistance=math.inf, **options)),
        "volume_stress": figures(volumes.zero, volumes.pole, volumes.sensor_gain, volumes.encoder_gain),
        "pair_of_forces": figures_of(make_bench(apa=plane, **options)),
        "beam_model": figures(beam_zero, beam_pole, *beam_model.static_gains(beam)),
    }
    by_charge, _ = gains_of_a_soft_sensor(ported)
    plane_charge, by_ends = gains_of_a_soft_sensor(plane_ports)
    summary = {
        "payload_mass_kg": args.payload_mass,
        "step_open_over_shorted_sensor": by_charge / routes["ports"]["sensor_V_per_V"] - 1,
        "step_plane_faces": plane_charge / by_charge - 1,
        "step_ends_for_volume": by_ends / plane_charge - 1,
        "step_forces_for_strain": routes["pair_of_forces"]["sensor_V_per_V"] / by_ends - 1,
        "ports_axial_stiffness_N_per_m": axial_stiffness(ported),
        "beam_model_axial_stiffness_N_per_m": beam_model.axial_stiffness(beam),
        "volume_stress_axial_stiffness_N_per_m": volumes.stiffness,
        "beam_model_stroke_m": beam_model.stroke(beam),
        "volume_stress_stroke_m": volumes.stroke,
        "beam_model_shorted_zero_Hz": beam_zero,
        "axial_stress_zero_Hz": volumes.axial_zero,
        "beam": asdict(beam),
    }
    for name, row in routes.items():
        summary |= with_prefix(name, row)
    print_table("sensor open", rows_of(summary, routes), COLUMNS)
    print_report(REPORT, summary)
    write_summary(args.output, summary)


def figures_of(scene: Scene) -> dict[str, float]:
    """Return zero, pole and static gains of a bench, from its linear model."""
    model = linearize(scene)
    found = pole_and_zero(model)
    return figures(found["zero_Hz"], found["pole_Hz"], *static_gains(model).values())


def figures(zero: float, pole: float, sensor: float, encoder: float) -> dict[str, float]:
    """Return the figures by which the routes are compared."""
    return {"zero_Hz": zero, "pole_Hz": pole, "sensor_V_per_V": sensor, "encoder_m_per_V": abs(encoder)}


if __name__ == "__main__":
    run(main)
