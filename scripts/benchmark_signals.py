"""Time exact steps, estimated and computed FRFs, and identified modes beside a limit and a peer.

The limit is the matrix product or Fourier transform that the work requires at least. All three process the same data in
turns in one run. Peers are SciPy's `lsim` and `csd`, python-control's `frequency_response`, and loops that are
evaluated sample by sample, as converters with a resolution require. The difference is that from the peer's result, as a
share of the largest value. For identified modes it is the difference from the truth in standard deviations.
"""

from typing import Any

import numpy as np

from common.arguments import parser, run, whole
from common.costs import peak_memory, timed
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from common.signal_routes import RATE, Row, deviation, estimation, identification, stepping
from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import frequency_response, simulate
from nassim.signals import band_limited_noise
from nassim.systems import LinearModel, to_control

arguments = parser(__doc__, "benchmark_signals")
arguments.add_argument(
    "--samples", type=whole(20_000), default=200_000, help="samples of the signals (default: 200000)"
)
arguments.add_argument("--states", type=whole(2), default=500, help="states of the model (default: 500)")
arguments.add_argument(
    "--turns", type=whole(1), default=3, help="repetitions, of which the fastest counts (default: 3)"
)
COLUMNS = {
    "size": "size:,",
    "time [ms]": "time_s*1e3:.1f",
    "limit [ms]": "limit_s*1e3:.1f",
    "peer [ms]": "peer_s*1e3:.0f",
    "times peer": "speed_over_peer:.1f",
    "difference": "difference:.1e",
}
REPORT = "largest memory of all: {memory_B*1e-9:.2f} GB"


def response(modes: int) -> Row:
    """Time 2 x 2 responses of uncoupled modes at 1000 frequencies; the limit is one product of their gains."""
    omega, random = 2 * np.pi * np.geomspace(10.0, 1e5, modes), np.random.default_rng(2)
    nothing, eye = np.zeros((modes, modes)), np.eye(modes)
    a = np.block([[nothing, eye], [-np.diag(omega**2), -np.diag(0.02 * omega)]])
    b, c = np.vstack([np.zeros((modes, 2)), random.normal(size=(modes, 2))]), random.normal(size=(2, modes))
    model = LinearModel(a, b, np.hstack([c, 0 * c]), np.zeros((2, 2)), ("u", "v"), ("y", "z"))
    frequency, system = np.geomspace(1.0, 1e4, 1000), to_control(model)
    gains = np.ones((4, 2 * modes), complex), np.ones((2 * modes, 1000), complex)

    def controls() -> Any:
        return system.frequency_response(2 * np.pi * frequency, squeeze=False).complex

    return Row(
        2 * modes, lambda: frequency_response(model, frequency).values, lambda: np.matmul(*gains), controls, deviation
    )


def main() -> None:
    args = arguments.parse_args()
    bench = make_bench(apa=reduced_apa300ml(), fidelity="linear")
    noise = band_limited_noise(args.samples / RATE, RATE, cutoff_frequency=300.0, rms=1e-3)
    record = simulate(bench, noise, time_step=1 / RATE, method="exact", progress=False)
    rows = {**stepping(bench, noise), "estimate_frf": estimation(record), "identify_modes": identification(record)}
    rows["frequency_response"] = response(args.states // 2)
    best: dict[str, list[float]] = {name: [np.inf] * 3 for name in rows}
    summary: dict[str, Any] = {"samples": args.samples, "turns": args.turns}
    for _ in range(args.turns):
        for name, row in rows.items():
            results = [(None, np.inf) if work is None else timed(work) for work in (row.work, row.limit, row.peer)]
            best[name] = [min(before, wall) for before, (_, wall) in zip(best[name], results, strict=True)]
            work, limit, peer = best[name]
            figures = {"size": row.size, "time_s": work, "limit_s": limit}
            figures["peer_s"] = peer if row.peer else None
            figures["speed_over_peer"] = peer / work if row.peer else None
            figures["difference"] = row.difference(results[0][0], results[2][0])
            summary |= with_prefix(name, figures)
    summary["memory_B"] = peak_memory()
    print_table("", rows_of(summary, rows), COLUMNS)
    print_report(REPORT, summary)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
