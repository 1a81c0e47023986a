"""Reduce the APA300ML and compare the 36 coordinates with the full FE model and with the paper.

Prints mass, stiffness and eigenfrequencies; draws the mesh, the remote points and the first modes.
"""

import numpy as np
from _common import parser, positive, run, whole, write_summary

from models.apa300ml import PAPER_FREQUENCY_FE, PRISMS, VENDOR_STIFFNESS, make_apa300ml
from models.bench import formula_frequency
from nassim import build_fe_model, condense, craig_bampton
from nassim.fem import full_eigenfrequencies
from nassim.plotting import plot_body, plot_mode, plt, save_figure

arguments = parser(__doc__, "reduce_apa")
arguments.add_argument("--element-size", type=positive, default=5.0, help="largest element [mm] (default: 5)")
arguments.add_argument("--order", type=whole(1), default=3, help="order of the elements (default: 3)")
arguments.add_argument("--modes", type=whole(0), default=6, help="fixed-interface modes (default: 6)")
arguments.add_argument("--coupling", choices=["rbe2", "rbe3"], default="rbe3", help="(default: rbe3)")
arguments.add_argument("--discretization", action="store_true", help="estimate the elements' error too (15 s)")
arguments.add_argument("--tetrahedra", action="store_true", help="no prisms in the frame and the stacks")

CASES = {
    "bottom clamped": {"fixed": ["bottom"]},
    "free": {},
    "5 kg, guided along z": {"fixed": ["bottom"], "guided": {"top": "z"}, "masses": {"top": 5.0}},
}


def main() -> None:
    args = arguments.parse_args()
    fe_model = build_fe_model(
        make_apa300ml(coupling=args.coupling),
        element_size=1e-3 * args.element_size,
        order=args.order,
        **({} if args.tetrahedra else PRISMS),
    )
    condensed = condense(fe_model)
    body = craig_bampton(condensed, n_modes=args.modes, discretization=args.discretization)
    print(f"\n{body.record['coordinates']}")

    compliance = body.compliance(fixed=["bottom"])
    top = body.coordinate_names.index("top.uz")
    stiffness = 1.0 / compliance[top, top]
    print(f"mass               {1e3 * body.mass:9.2f} g      integral of the density {1e3 * fe_model.mass:.2f} g")
    print(
        f"axial stiffness    {1e-6 * stiffness:9.3f} N/um   vendor {1e-6 * VENDOR_STIFFNESS:.2f} N/um"
        f" ({100 * (stiffness / VENDOR_STIFFNESS - 1):+.1f} %)"
    )
    summary = {
        "mass_kg": body.mass,
        "mass_by_density_kg": fe_model.mass,
        "axial_stiffness_N_per_m": stiffness,
        "vendor_axial_stiffness_N_per_m": VENDOR_STIFFNESS,
        "axial_stiffness_difference_percent": 100 * (stiffness / VENDOR_STIFFNESS - 1),
        "record": body.record,
        "n_dofs_full": fe_model.n_dofs,
        "n_coordinates": len(body.mass_matrix),
    }

    tables = {}
    for name, conditions in CASES.items():
        reduced = body.eigenfrequencies(n=12, **conditions)
        reduced = reduced[reduced > 1.0][:5]
        full = full_eigenfrequencies(condensed, n=12, progress=False, **conditions)
        tables[name] = (reduced, full[full > 1.0][:5])
    print("\neigenfrequencies [Hz]        1          2          3          4          5")
    for name, (reduced, full) in tables.items():
        print(f"{name}")
        print("  full FE model    " + " ".join(f"{f:10.2f}" for f in full))
        print("  36 coordinates   ".replace("36", str(len(body.mass_matrix))) + " ".join(f"{f:10.2f}" for f in reduced))
        print("  error            " + " ".join(f"{100 * e:8.3f} %" for e in reduced / full - 1))
        key = name.replace(",", "").replace(" ", "_")
        summary |= {f"{key}_full_Hz": full, f"{key}_reduced_Hz": reduced}
        summary[f"{key}_error_percent"] = 100 * (reduced / full - 1)
    first = tables["5 kg, guided along z"][0][0]
    print(
        f"\nwith 5 kg: {first:.2f} Hz; paper: {PAPER_FREQUENCY_FE} Hz by FE"
        f" ({100 * (first / PAPER_FREQUENCY_FE - 1):+.2f} %), {formula_frequency():.1f} Hz by sqrt(k/m)"
    )
    summary |= {"paper_fe_Hz": PAPER_FREQUENCY_FE, "formula_Hz": formula_frequency()}
    summary["difference_to_paper_fe_percent"] = 100 * (first / PAPER_FREQUENCY_FE - 1)
    summary["truncation_error_percent"] = 100 * body.truncation_errors(fixed=["bottom"], n=5)
    if args.discretization:
        summary["discretization_error_percent"] = 100 * body.discretization_errors(fixed=["bottom"], n=5)

    if not args.no_plot:
        save_figure(plot_body(body), args.output / "mesh_and_remote_points.png")
        frequency, shapes = body.eigenmodes(**CASES["bottom clamped"], n=6)
        figure = plt.figure(figsize=(15, 7))
        figure.subplots_adjust(wspace=0, hspace=0.05)
        axes = [figure.add_subplot(2, 3, k + 1, projection="3d") for k in range(6)]
        for k, ax in enumerate(axes):
            plot_mode(body, shapes[:, k], title=f"mode {k + 1}, bottom clamped: {frequency[k]:.1f} Hz", ax=ax)
        save_figure(axes, args.output / "modes.png")
    write_summary(args.output, summary)


if __name__ == "__main__":
    np.set_printoptions(precision=4)
    run(main)
