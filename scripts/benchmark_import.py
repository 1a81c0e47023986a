"""Measure time and memory of importing nassim, and of small tasks right after it, each in a new process.

`--other DIR` measures another version of nassim in turns with this one. DIR is the folder that contains its package.
"""

import subprocess
import sys
from pathlib import Path

from common.arguments import parser, run, whole
from common.report import print_table, write_summary

CASES = {
    "import nassim": "import nassim",
    "a linear system": "import nassim; nassim.LinearModel, nassim.frequency_response, nassim.Controller",
    "a file": "import nassim; nassim.load, nassim.TimeHistory, nassim.FRF, nassim.ReducedBody",
    "a scene's linear model": "import nassim; nassim.Scene, nassim.linearize",
    "every public name": "import nassim; [getattr(nassim, name) for name in nassim.__all__]",
    "numpy and scipy.linalg": "import numpy, scipy.linalg",
}
MEASURE = """
import resource, sys, time
sys.path.insert(0, sys.argv[1])
start = time.perf_counter()
exec(sys.argv[2])
print(time.perf_counter() - start, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
"""

arguments = parser(__doc__, "benchmark_import")
arguments.add_argument(
    "--repetitions", type=whole(1), default=7, help="repetitions, of which the fastest counts (default: 7)"
)
arguments.add_argument("--other", type=Path, help="folder of another version to compare with")


def cost(folder: Path, code: str) -> tuple[float, float]:
    """Return time [s] and largest memory [bytes] of a process that runs code with the package in a folder."""
    command = [sys.executable, "-c", MEASURE, str(folder), code]
    run = subprocess.run(command, capture_output=True, text=True, check=True)
    time_s, memory = map(float, run.stdout.split())
    return time_s, memory


def main() -> None:
    args = arguments.parse_args()
    folders = {"": Path(__file__).parents[1], **({"other_": args.other.resolve()} if args.other else {})}
    summary: dict[str, dict[str, float]] = {case: {} for case in CASES}
    for case, code in CASES.items():
        found = [{prefix: cost(folder, code) for prefix, folder in folders.items()} for _ in range(args.repetitions)]
        for prefix in folders:
            summary[case][f"{prefix}time_s"] = min(costs[prefix][0] for costs in found)
            summary[case][f"{prefix}memory_B"] = min(costs[prefix][1] for costs in found)
    columns = {"time [s]": "time_s:.3f", "memory [MB]": "memory_B*1e-6:.0f"}
    if args.other:
        columns |= {"other's time [s]": "other_time_s:.3f", "memory [MB] ": "other_memory_B*1e-6:.0f"}
    print_table("loaded for", summary, columns)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
