"""Dynamic error budget of the end-station: which disturbance moves the sample by how much, and what loops leave of it.

Floor, runout of the spindle and noise of stages act on granite, stages and nano-hexapod. Three machines: open, damped
by six loops of integral force feedback, and that within a loop of the sample's pose, sampled with its delay. The
spindle is held; what a turning one does to poles is told beside, for a station alike in all directions across its axis.
Unless a file gives them, spectra are ASSUMED and stand for no real floor, spindle or stage, as most figures of the
stages do (`models.nass`): whether aims are met says nothing of the real machine.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
from _arguments import parser, positive, run
from _nass_machines import least_damping, machines, pose_sensitivity, shares, turning_figures
from _nass_pictures import plot_budgets, plot_sensitivity
from _nass_spectra import assumed_spectra, read_spectra
from _report import print_report, print_table
from _results import write_summary

from models.hexapods import NANO_HEXAPOD
from models.nass import make_nass, suspension
from models.nass_loops import POSE, force_loop
from nassim import linearize
from nassim.systems import noise_budget, sampled

AIMS = {"ux": 30e-9, "uy": 30e-9, "uz": 15e-9, "rx": 250e-9, "ry": 250e-9, "rz": None}
"""Rms at the sample that is aimed at [m], [rad]."""

arguments = parser(__doc__, "nass_budget")
arguments.add_argument("--spectra", type=Path, help="CSV: frequency [Hz], and by input its density in SI, unit^2/Hz")
for name, default, text in (
    ("--floor", 0.2e-6, "assumed, in each third of an octave below 20 Hz [m/s]"),
    ("--runout", 50e-9, "of the spindle, assumed, rms, mostly below 5 Hz [m]"),
    ("--stage", 20e-9, "noise of the stages, assumed, rms, mostly below 5 Hz [m]"),
    ("--payload-mass", 10.0, "[kg]"),
    ("--height", 0.1, "of the sample above the plate [m]"),
    ("--gain", 200.0, "of the force feedback [1/s]"),
    ("--crossover", 15.0, "of the pose's loops [Hz]"),
    ("--speed", 60.0, "at which poles are told [rpm]"),
    ("--sample-rate", 10e3, "of all loops [Hz]"),
    ("--highest", 500.0, "end of the budget's band [Hz]"),
):
    arguments.add_argument(name, type=positive, default=default, help=f"{text} (default: {default:g})")
arguments.add_argument("--coordinates", choices=("struts", "cartesian"), default="struts", help="of the pose's loops")

REPORT = """
spectra: {spectra}; stages: figures assumed or unverified, see models.nass
loops at {sample_rate_Hz:g} Hz with a sample of delay: force feedback {gain_per_s:g}/s; pose by {coordinates}, \
crossover {crossover_Hz:g} Hz, largest sensitivity {largest_sensitivity:.2f}
least damping ratio below 150 Hz: open {least_damping/open*100:.2f} %, damped {least_damping/damped*100:.2f} %, \
pose {least_damping/pose*100:.2f} %
at {speed_rpm:g} rpm, stages alike across the axis, force feedback: {spinning}; modes move by up to \
{spinning_shift_Hz:.2f} Hz"""
MODES = {"frequency [Hz]": "Hz:.2f", "moves most": "moves"}
AXES = {"x [nm]": "ux*1e9:.1f", "y [nm]": "uy*1e9:.1f", "z [nm]": "uz*1e9:.1f", "rx [nrad]": "rx*1e9:.0f"}
AXES |= {"ry [nrad]": "ry*1e9:.0f", "rz [nrad]": "rz*1e9:.0f"}


def main() -> None:
    args = arguments.parse_args()
    platform = replace(NANO_HEXAPOD, point=np.array([0, 0, args.height]))
    scene = make_nass(platform=platform, payload_mass=args.payload_mass)
    if args.spectra:
        label, spectra = f"from {args.spectra}", read_spectra(args.spectra, scene.inputs)
    else:
        label = f"ASSUMED: floor {args.floor:g} m/s, runout {args.runout:g} m, stages {args.stage:g} m"
        spectra = assumed_spectra(scene.inputs, floor=args.floor, runout=args.runout, stage=args.stage)
    force = force_loop(args.gain, sample_rate=args.sample_rate)
    models, pose = machines(
        sampled(linearize(scene), args.sample_rate), force, args.crossover, args.coordinates, platform
    )
    band = np.geomspace(1.0, args.highest, 300)
    budgets = {name: noise_budget(model, spectra, band, outputs=POSE) for name, model in models.items()}
    left = pose_sensitivity(models["damped"], pose, band)
    summary = {
        "spectra": label,
        **{"sample_rate_Hz": args.sample_rate, "gain_per_s": args.gain},
        "crossover_Hz": args.crossover,
        "coordinates": args.coordinates,
        "modes": [{"Hz": f, "moves": ", ".join(list(shares)[:3])} for f, shares in suspension(scene)],
        "least_damping": {name: least_damping(model) for name, model in models.items()},
        "largest_sensitivity": np.abs(np.einsum("iif->if", left.values)).max(),
        **turning_figures(args.speed, force, platform, args.payload_mass),
        "rms": shares(budgets),
        "aims": AIMS,
    }
    print_table("modes below 150 Hz", {str(k): mode for k, mode in enumerate(summary["modes"], 1)}, MODES)
    print_report(REPORT, summary)
    for name, rows in summary["rms"].items():
        print_table(f"{name}, rms", {**rows, "aim": summary["aims"]}, AXES)
    if not args.no_plot:
        plot_budgets(budgets, AIMS, label, args.output / "budget.png")
        plot_sensitivity(left, args.output / "sensitivity.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
