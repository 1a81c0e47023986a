"""Steps of the bench and of hexapods with loops in every fidelity, beside limits, peers and the exact solution.

The limit is Exudyn's own step of the same model, without loops, looks and records, or the matrix product that exact
steps cannot do without. Peers are SciPy's `lsim` and the usual Exudyn construction: the same reduced body, tied by all
nodes of the faces (mean of their motions) and pushed by a connector with a force function; that only takes the first
5 % of the steps. All take the same noise, in one run, in turns, on one thread; times are the processor's.
"""

from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import scipy
from _arguments import parser, run, whole
from _race import Route, race, simulated
from _report import print_report, print_table, rows_of, with_prefix
from _results import write_summary
from _stepping_rows import compensated, hexapods, limit
from _usual_construction import STEP, usual_construction

from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import Loop, TimeHistory, describe, frequency_response, linearize
from nassim.signals import band_limited_noise
from nassim.systems import integral_force_feedback

CUTOFF = 1500.0
USUAL, LSIM = "usual construction", "SciPy's lsim"
ALPHA = "generalized_alpha"
IFF = Loop("iff", integral_force_feedback(20.0, sample_rate=1 / STEP), "sensor_voltage", "actuator_voltage")
LOOPS = {"exact, loop": IFF, "exact, coarse loop": replace(IFF, input_step=1e-8, output_step=1e-8)}
ROUTES: dict[str, tuple[dict[str, Any], str]] = {
    "ffrf": ({}, ALPHA),
    "ffrf, trimmed": ({"cutoff_frequency": CUTOFF}, ALPHA),
    "linear": ({"fidelity": "linear"}, ALPHA),
    "linear, trimmed": ({"fidelity": "linear", "cutoff_frequency": CUTOFF}, ALPHA),
    **dict.fromkeys(("exact", *LOOPS), ({"fidelity": "linear"}, "exact")),
}
"""Options of the bench and method of the simulation."""

arguments = parser(__doc__, "benchmark_stepping")
arguments.add_argument("--steps", type=whole(20), default=10000, help="of 0.1 ms, per route and turn (default: 10000)")
arguments.add_argument("--turns", type=whole(1), default=3, help="the fastest of which counts (default: 3)")
COLUMNS = {
    "us/step": "us_per_step:.1f",
    "limit": "limit_us_per_step:.2f",
    "peer": "peer_us_per_step:.0f",
    "times peer": "speed_over_peer:.1f",
    "difference": "difference:.1e",
    "real time": "speed_over_real_time:.2f",
    "error of d_e [%]": "encoder_error*100:.3g",
}
REPORT = """(steps make up for what their rule does to periods; what is left is told by nassim.simulation.period_errors)
FRFs of the trimmed bench up to 500 Hz: within {trimmed_frf_error*100:.2g} %
{trimmed_scene}"""


def main() -> None:
    args = arguments.parse_args()
    apa = reduced_apa300ml()
    # Nanometres: where the fidelities must agree.
    noise = band_limited_noise(args.steps * STEP, 1 / STEP, cutoff_frequency=300.0, rms=1e-5)
    few = args.steps // 20 + 1
    start_only = TimeHistory(noise.time[:few], noise.values[:, :few], noise.names, noise.units)
    routes = {USUAL: Route(partial(usual_construction, make_bench(apa=apa), start_only), STEP, "exact")}
    for label, (options, method) in ROUTES.items():
        scene = replace(make_bench(apa=apa, **options), loops=(LOOPS[label],) if label in LOOPS else ())
        true = "exact, loop" if label in LOOPS else "exact"
        peer = USUAL if method == ALPHA else "" if label in LOOPS else LSIM
        bare = limit(scene, method, STEP, args.steps)
        routes[label] = Route(simulated(scene, noise, "encoder", STEP, method), STEP, true, None, bare, peer)
    model = linearize(make_bench(apa=apa, fidelity="linear")).matrices
    routes[LSIM] = Route(lambda: scipy.signal.lsim(model, noise.values[0], noise.time)[1][:, 1], STEP, "exact")
    figures = race(routes, args.turns)
    summary: dict[str, Any] = {"steps": args.steps, "time_step_s": STEP}
    for label, row in figures.items():
        for other, name in (("ffrf", "ffrf"), (USUAL, "usual")):
            row[f"speed_over_{name}"] = row["steps_per_s"] / figures[other]["steps_per_s"]
        summary |= with_prefix(label, row)
    others = {"steps": compensated(apa, args.steps), "trimmed, six loops": hexapods(apa, max(args.steps, 200))}
    for label, row in (pair for more in others.values() for pair in race(more, args.turns).items()):
        summary |= with_prefix(label, row)
    frequency = np.geomspace(1, 500, 500)
    trimmed = make_bench(apa=apa, cutoff_frequency=CUTOFF)
    full, cut = (frequency_response(linearize(b), frequency).values for b in (make_bench(apa=apa), trimmed))
    scale = np.maximum(np.abs(full), np.abs(full[:, :, :1]))
    summary["trimmed_frf_error"] = float(np.max(np.abs(cut - full) / scale))
    summary["trimmed_scene"] = describe(trimmed)

    print_table("", {name: rows_of(summary, [name])[name] for name in routes}, COLUMNS)
    for title, more in others.items():
        print_table(title, {name: rows_of(summary, [name])[name] for name in more}, COLUMNS)
    print_report(REPORT, summary)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
