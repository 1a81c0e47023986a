"""How costs grow: with nodes (reduction), struts (a step), states (a step, a response) and samples (signals).

Every size runs in a process of its own and on one thread; times are the processor's, so that other work on the machine
matters little. Memory is the process's largest, beside how far it grew since its libraries were loaded. Exponents are
those of cost ~ size^exponent, by least squares of the logarithms, with their standard errors: a cost that does not
depend on the size makes them smaller at small sizes.

Samples go through simulate, estimate_frf and identify_modes in one process: its memory is that of all three together.
"""

import json
import os
from typing import Any

from _arguments import parser, positive, run, several, whole
from _costs import run_in_own_process
from _results import write_summary
from _scaling_report import exponents, print_growth, save_picture

from models.apa300ml import reduced_apa300ml

DEFAULTS = {"nodes": "4,2.2,1.6,1.4", "struts": "1,2,3,4,6,8,12", "states": "4,8,16,32,64"}
DEFAULTS["samples"] = "100000,316000,1000000,3160000,10000000"

arguments = parser(__doc__, "benchmark_scaling")
arguments.add_argument(
    "--nodes",
    type=several(positive),
    default=DEFAULTS["nodes"],
    help="element sizes [mm]; 0.92 gives 150 000 nodes; '' for none, as of the others (default: %(default)s)",
)
arguments.add_argument(
    "--struts", type=several(whole(1)), default=DEFAULTS["struts"], help="numbers (default: %(default)s)"
)
arguments.add_argument(
    "--states", type=several(whole(1)), default=DEFAULTS["states"], help="bodies of 12 states (default: %(default)s)"
)
arguments.add_argument(
    "--samples", type=several(whole(20_000)), default=DEFAULTS["samples"], help="numbers (default: %(default)s)"
)
arguments.add_argument("--child", nargs=2, metavar=("KIND", "SIZE"), help="for the script's own use")


def main() -> None:
    args = arguments.parse_args()
    if args.child:
        # Imported here because only children work.
        from _scaling_works import measure  # noqa: PLC0415

        print("\n" + json.dumps(measure(args.child[0], float(args.child[1]))))
        return
    reduced_apa300ml()  # in the cache from now on
    os.environ.update(dict.fromkeys(("NASSIM_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1"))
    summary: dict[str, Any] = {"exponents": {}}
    for kind in DEFAULTS:
        summary[kind] = {f"{size:.12g}": run_in_own_process(__file__, kind, size) for size in getattr(args, kind)}
        summary["exponents"][kind] = exponents(summary[kind])
    for kind in DEFAULTS:
        print_growth(kind, summary[kind], summary["exponents"][kind])
    if not args.no_plot:
        save_picture(args.output / "scaling.png", summary, summary["exponents"])
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
