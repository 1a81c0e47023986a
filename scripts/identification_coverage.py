"""Measure errors of identified modes over many blind records, and how often 95 % intervals contain the truth.

The script repeats the blind demonstration of identify_damping.py with other parameters, noise and second resonances.
For each parameter it prints the range of errors over the first ten records and over all, and the share of intervals
that contain the truth.
"""

import numpy as np

from common.arguments import not_negative, parser, positive, run, whole
from common.blind import against_truth, make_blind_record
from common.report import print_report, print_table, write_summary
from models.apa300ml import COARSE, reduced_apa300ml
from models.bench import make_bench
from nassim.identification import apply_identification, identify_modes
from nassim.signals import read_measurement

WITHIN = 1.96
FEW = 10
arguments = parser(__doc__, "identification_coverage")
arguments.add_argument("--repetitions", type=whole(1), default=40, help="number of blind records (default: 40)")
arguments.add_argument("--duration", type=positive, default=16.0, help="length of a record [s] (default: 16)")
arguments.add_argument(
    "--noise", type=not_negative, default=0.05, help="rms of the noise over that of the signal (default: 0.05)"
)

COLUMNS = {
    "first ten, lowest": "error_of_first_ten_in_percent/0:.4f",
    "highest": "error_of_first_ten_in_percent/1:.4f",
    "largest of all": "largest_error_in_percent:.4f",
    "covered": "covered",
}


def main() -> None:
    args = arguments.parse_args()
    bench = make_bench(5.0, "linear", apa=reduced_apa300ml(**COARSE))
    errors, scaled = [], []
    for seed in range(args.repetitions):
        path, truth = make_blind_record(args.output, seed=seed, noise=args.noise, duration=args.duration)
        signals = {"input": "actuator_voltage", "outputs": list(bench.outputs), "band": (20.0, 500.0)}
        fit = identify_modes(read_measurement(path), **signals, n_modes=2, hold_order=0)
        found = against_truth(fit, apply_identification(bench, fit, trusted="encoder")[1], truth)
        errors.append(list(found["errors_in_percent"].values()))
        scaled.append(np.abs(list(found["errors_over_std"].values())))
    covered, worst = np.array(scaled) < WITHIN, np.abs(errors)
    few = slice(min(FEW, args.repetitions))
    parameters = {
        name: {
            "error_of_first_ten_in_percent": [np.min(errors[few], axis=0)[k], np.max(errors[few], axis=0)[k]],
            "largest_error_in_percent": worst[:, k].max(),
            "covered_of_first_ten": int(covered[few, k].sum()),
            "covered": int(covered[:, k].sum()),
        }
        for k, name in enumerate(found["fitted"])
    }
    summary = {
        "repetitions": len(errors),
        "covered_in_percent": 100 * covered.mean(),
        "parameters": parameters,
    }
    print_table("errors [%]", parameters, COLUMNS)
    print_report("{covered_in_percent:.1f} % of the intervals of {repetitions} records hold the truth", summary)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
