"""Reduce the APA300ML and compare the 36 coordinates with the full FE model and with the paper.

The script prints mass, stiffness and eigenfrequencies. It draws the mesh, the remote points and the first modes, as
pictures and as pages that can be rotated in the browser.
"""

from common.arguments import parser, positive, run, whole
from common.report import print_report, print_table, rows_of, with_prefix, write_summary
from common.views import show
from models.apa300ml import PAPER_FREQUENCY_FE, PRISMS, VENDOR_STIFFNESS, axial_stiffness, make_apa300ml
from models.bench import formula_frequency
from nassim import build_fe_model, condense, craig_bampton
from nassim.fem import full_eigenfrequencies
from nassim.viewer import view_mesh, view_modes

arguments = parser(__doc__, "reduce_apa")
arguments.add_argument("--element-size", type=positive, default=5.0, help="largest element [mm] (default: 5)")
arguments.add_argument("--order", type=whole(1), default=3, help="order of the elements (default: 3)")
arguments.add_argument("--modes", type=whole(0), default=6, help="fixed-interface modes (default: 6)")
arguments.add_argument(
    "--coupling", choices=["rbe2", "rbe3"], default="rbe3", help="coupling of remote points (default: rbe3)"
)
arguments.add_argument("--discretization", action="store_true", help="estimate the discretisation error (15 s)")
arguments.add_argument(
    "--tetrahedra", action="store_true", help="tetrahedra only, in place of prisms in frame and stacks"
)

CASES = {
    "bottom clamped": {"fixed": ["bottom"]},
    "free": {},
    "5 kg, guided along z": {"fixed": ["bottom"], "guided": {"top": "z"}, "masses": {"top": 5.0}},
}

REPORT = """
{n_dofs_full} degrees of freedom in {n_coordinates} coordinates
mass            {mass_kg*1e3:.2f} g, integral of the density {mass_by_density_kg*1e3:.2f} g
axial stiffness {axial_stiffness_N_per_m*1e-6:.3f} N/um, vendor {vendor_axial_stiffness_N_per_m*1e-6:.2f} N/um \
({axial_stiffness_difference_percent:+.2f} %)
with 5 kg       {5_kg_guided_along_z_reduced_Hz/0:.2f} Hz, paper {paper_fe_Hz} Hz by FE \
({difference_to_paper_fe_percent:+.2f} %), {formula_Hz:.1f} Hz by sqrt(k/m)
"""


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
    stiffness = axial_stiffness(body)
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
    for name, conditions in CASES.items():
        both = (
            body.eigenfrequencies(n=12, **conditions),
            full_eigenfrequencies(condensed, n=12, progress=False, **conditions),
        )
        reduced, full = (frequency[frequency > 1.0][:5] for frequency in both)
        error = 100 * (reduced / full - 1)
        summary |= with_prefix(name, {"full_Hz": full, "reduced_Hz": reduced, "error_percent": error})
    first = summary["5_kg_guided_along_z_reduced_Hz"][0]
    summary |= {"paper_fe_Hz": PAPER_FREQUENCY_FE, "formula_Hz": formula_frequency()}
    summary["difference_to_paper_fe_percent"] = 100 * (first / PAPER_FREQUENCY_FE - 1)
    summary["truncation_error_percent"] = 100 * body.truncation_errors(fixed=["bottom"], n=5)
    if args.discretization:
        summary["discretization_error_percent"] = 100 * body.discretization_errors(fixed=["bottom"], n=5)

    print_report(REPORT, summary)
    for name, figures in rows_of(summary, CASES).items():
        rows = {key.replace("_", " "): {"all": values} for key, values in figures.items()}
        print_table(name, rows, {str(k + 1): f"all/{k}:.3f" for k in range(5)})
    if not args.no_plot:
        show(view_mesh(fe_model), args.output / "mesh_and_remote_points", mesh=True)
        modes = view_modes(body, **CASES["bottom clamped"], n=6)
        show(modes, args.output / "modes", modes=[mode.name for mode in modes.modes], size=(1800, 1000))
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
