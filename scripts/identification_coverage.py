"""How far identified modes are off over many blind records, and how often the 95 % intervals cover the truth.

Repeats identify_damping.py's blind demonstration, each time with other parameters, noise and second resonance. Prints
per parameter the range of errors over the first ten records and over all, and how many intervals hold the truth.
"""

import numpy as np
from _common import not_negative, parser, positive, run, whole, write_summary
from identify_damping import UNITS, figures
from make_blind_record import make_blind_record

from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim.identification import apply_identification, identify_modes
from nassim.signals import read_measurement

WITHIN = 1.96
FEW = 10
arguments = parser(__doc__, "identification_coverage")
arguments.add_argument("--repetitions", type=whole(1), default=40, help="blind records (default: 40)")
arguments.add_argument("--duration", type=positive, default=16.0, help="of a record [s] (default: 16)")
arguments.add_argument("--noise", type=not_negative, default=0.05, help="rms over the signal's rms (default: 0.05)")


def main() -> None:
    args = arguments.parse_args()
    bench = make_bench(5.0, "linear", apa=reduced_apa300ml(element_size=8e-3, order=2, mesh={}))
    errors, scaled = [], []
    for seed in range(args.repetitions):
        path, truth = make_blind_record(args.output, seed=seed, noise=args.noise, duration=args.duration)
        signals = {"input": "actuator_voltage", "outputs": list(UNITS), "band": (20.0, 500.0)}
        fit = identify_modes(read_measurement(path), **signals, n_modes=2, hold_order=0)
        found = figures(fit, apply_identification(bench, fit, trusted="encoder")[1])
        errors.append([100 * (value / truth[name] - 1) for name, (value, _) in found.items()])
        scaled.append([abs(value - truth[name]) / std for name, (value, std) in found.items()])
    covered, worst = np.array(scaled) < WITHIN, np.abs(errors)
    few = slice(min(FEW, args.repetitions))
    print(f"\n{'':<32}{'error, first ten [%]':>28}{'largest of all':>16}{'covered':>10}")
    for k, name in enumerate(found):
        low, high = np.min(errors[few], axis=0)[k], np.max(errors[few], axis=0)[k]
        print(
            f"{name:<32}{low:>14.4f} ...{high:>10.4f}{worst[:, k].max():>16.4f}{covered[:, k].sum():>7}/{len(errors)}"
        )
    print(f"{covered.sum()} of {covered.size} intervals hold the truth, {100 * covered.mean():.1f} %")
    write_summary(
        args.output,
        {
            "repetitions": len(errors),
            "covered_in_percent": 100 * covered.mean(),
            "parameters": {
                name: {
                    "error_of_first_ten_in_percent": [np.min(errors[few], axis=0)[k], np.max(errors[few], axis=0)[k]],
                    "largest_error_in_percent": worst[:, k].max(),
                    "covered_of_first_ten": int(covered[few, k].sum()),
                    "covered": int(covered[:, k].sum()),
                }
                for k, name in enumerate(found)
            },
        },
    )


if __name__ == "__main__":
    run(main)
