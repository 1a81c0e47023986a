"""Simulate a record of a bench with random, unknown parameters, to test an identification blindly.

Payload mass, damping ratios, and factors of actuator and sensor are random. On the payload there is a second APA300ML
with a mass, a resonance that the usual bench does not have. The script writes record.csv (actuator_voltage,
sensor_voltage, encoder, with noise), and the true parameters to summary.json.
"""

from common.arguments import not_negative, parser, positive, run, whole
from common.blind import make_blind_record
from common.report import write_summary

arguments = parser(__doc__, "make_blind_record")
arguments.add_argument("--seed", type=whole(0), default=0, help="seed of all random numbers (default: 0)")
arguments.add_argument(
    "--noise", type=not_negative, default=0.05, help="rms of the noise over that of the signal (default: 0.05)"
)
arguments.add_argument("--duration", type=positive, default=16.0, help="length of the record [s] (default: 16)")


def main() -> None:
    args = arguments.parse_args()
    path, truth = make_blind_record(args.output, seed=args.seed, noise=args.noise, duration=args.duration)
    print(path)
    write_summary(args.output, truth)


if __name__ == "__main__":
    run(main)
