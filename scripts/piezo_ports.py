"""Compute gains, pole and zero of the bench with electrical ports in several circuits, and with a pair of forces.

As ports, the stacks act and measure over their volume. They also push sideways, an open sensor is stiffer than a
shorted one, and a resistance turns the sensor into a high-pass filter.
"""

import math
from dataclasses import replace

import numpy as np

from common.arguments import parser, positive, run
from common.report import print_table, rows_of, with_prefix, write_summary
from common.responses import plot_bode_pair
from models.apa300ml import COARSE, PORTS, STACK, reduced_apa300ml
from models.bench import SENSOR_RESISTANCE, make_bench
from models.bench_figures import pole_and_zero, static_gains
from nassim import frequency_response, linearize, truncation_error
from nassim.base.progress import tell
from nassim.plotting import save_figure

SHEET_CAPACITANCE = 4.4e-6
"""Capacitance of one stack by its own data sheet [F]; by the actuator's data sheet it is 6.7e-6."""

arguments = parser(__doc__, "piezo_ports")
arguments.add_argument("--payload-mass", type=positive, default=5.0, help="mass of the payload [kg] (default: 5)")
arguments.add_argument(
    "--resistance",
    type=positive,
    default=SENSOR_RESISTANCE,
    help="resistance across the sensor [Ohm] (default: %(default)g)",
)
arguments.add_argument("--coarse", action="store_true", help="mesh of 8 mm, for a quick look")

COLUMNS = {
    "V_s/V_a [V/V]": "static_gain_V_per_V:.4f",
    "d_e/V_a [um/V]": "static_gain_m_per_V*1e6:.2f",
    "pole [Hz]": "pole_Hz:.2f",
    "zero [Hz]": "zero_Hz:.2f",
    "truncation [%]": "truncation_error*100:.3f",
}


def main() -> None:
    args = arguments.parse_args()
    mesh = COARSE if args.coarse else {}
    apa = reduced_apa300ml(ports=PORTS, **mesh)
    sheet = tuple(replace(port, stack=replace(STACK, capacitance=SHEET_CAPACITANCE)) for port in PORTS)
    sheet_apa = reduced_apa300ml(ports=sheet, **mesh)
    pair = reduced_apa300ml(stack_coupling="rbe2", **mesh)
    common = {"payload_mass": args.payload_mass, "fidelity": "linear"}
    scenes = {
        "ports, sensor open": make_bench(**common, apa=apa, resistance=math.inf),
        f"ports, sensor with {args.resistance:g} Ohm": make_bench(**common, apa=apa, resistance=args.resistance),
        "ports, sensor shorted": make_bench(**common, apa=apa, resistance=1e-3),
        "ports, 4.4 uF a stack": make_bench(**common, apa=sheet_apa, resistance=math.inf),
        "pair of forces": make_bench(**common, apa=pair),
    }
    frequency, frfs = np.geomspace(0.5, 900.0, 6000), []
    compared = frequency[(frequency > 10) & (frequency < 500)]
    summary = {
        "payload_mass_kg": args.payload_mass,
        "resistance_Ohm": args.resistance,
        "stack_stiffness_N_per_m": STACK.stiffness,
        "stack_blocked_force_over_free_stroke_N_per_m": STACK.blocked_force / STACK.free_stroke,
        "stack_young_modulus_Pa": STACK.young_modulus,
        "stack_strain": STACK.free_stroke / STACK.length,
        "stack_blocked_stress_Pa": STACK.blocked_force / STACK.area,
        "stack_coupling_factor": STACK.coupling_factor,
    }
    for name, scene in scenes.items():
        model = linearize(scene)
        frfs.append(frequency_response(model, frequency, label=name))
        figures = {**static_gains(model), **pole_and_zero(model)}
        if "shorted" in name:
            figures["zero_Hz"] = None
        summary |= with_prefix(name, figures | {"truncation_error": truncation_error(scene, compared).max()})

    tell(f"stack: {STACK.consistency()}".replace("\n", "\n  "), indent="")
    print_table("static; truncation 10-500 Hz", rows_of(summary, scenes), COLUMNS)
    if not args.no_plot:
        save_figure(plot_bode_pair(frfs[:3]), args.output / "frf.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
