"""Time studies of benches in two processes beside a plain loop, and measure the overhead of scheduling and transfer.

A bench is simulated for 16 s of noise in linear fidelity, as run_bench.py does, and its FRF is estimated. Child
processes keep their memory between runs, while a plain loop releases it from time to time, so the ratio may be below
one half. On busy processors, wall times say little; `quiet_ratio` is the ratio of the CPU times, divided among the
processes. The largest useful number of workers is the duration of a run over the CPU time per run of the process that
handles all runs: this process, or the scheduler of the Dask cluster that the script starts by its command lines. More
workers would wait for that process.
"""

import functools
import itertools
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from common.arguments import parser, run, whole
from common.costs import timed
from common.report import print_report, print_table, write_summary
from models.apa300ml import reduced_apa300ml
from models.bench import make_bench
from nassim import FRF, ReducedBody, estimate_frf, simulate
from nassim.signals import band_limited_noise
from nassim.studies import sweep

DURATIONS = {"10 ms": 0.01, "1 s": 1.0, "60 s": 60.0}
NOISE = band_limited_noise(16.0, 10e3, cutoff_frequency=400.0, rms=0.1)
COLUMNS = {
    "wall time of a run [ms]": "wall_s*1e3:.2f",
    "processor time of it [ms]": "cpu_s*1e3:.2f",
    **{f"workers for {label}": f"workers_{label.replace(' ', '_')}:.0f" for label in DURATIONS},
}
REPORT = """{runs} linear benches of {bench_s*1e3:.1f} ms: plain loop {loop_s:.1f} s; {processes} processes
{study_s:.1f} s, ratio {ratio:.2f} ({quiet_ratio:.2f} on idle processors), largest difference {difference:.1e};
start of a child {start_s:.2f} s"""
arguments = parser(__doc__, "benchmark_studies")
arguments.add_argument("--runs", type=whole(4), default=500, help="number of benches (default: 500)")
arguments.add_argument(
    "--empty-runs", type=whole(10), default=2000, help="runs without work, for the overhead (default: 2000)"
)
arguments.add_argument("--processes", type=whole(1), default=2, help="child processes and Dask workers (default: 2)")


@contextmanager
def cluster(n_workers: int) -> Iterator[tuple[Any, psutil.Process]]:
    """Start `dask scheduler` and n `dask worker`; yield a client and the scheduler's process, then end all.

    Raises:
        ImportError: without dask
        RuntimeError: when the scheduler does not start
    """
    from dask.distributed import Client  # noqa: PLC0415 -- an optional dependency

    with tempfile.TemporaryDirectory() as folder:
        where = Path(folder, "scheduler.json")
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

        def start(*words: str) -> Any:
            command = [sys.executable, "-m", "dask", *words, "--scheduler-file", str(where), "--no-dashboard"]
            return subprocess.Popen(command, cwd=folder, env=environment, stderr=subprocess.DEVNULL)

        processes = [start("scheduler", "--host", "127.0.0.1", "--port", "0")]
        try:
            while not where.exists():
                if processes[0].poll() is not None:
                    raise RuntimeError("the command dask scheduler ended at once; try it by hand")
                time.sleep(0.05)
            processes += [start("worker", "--nthreads", "1") for _ in range(n_workers)]
            with Client(scheduler_file=str(where)) as client:
                client.wait_for_workers(n_workers, timeout=120)
                yield client, psutil.Process(processes[0].pid)
        finally:
            for process in reversed(processes):
                process.terminate()
            for process in processes:
                process.wait()


def bench(payload_mass: float, damping_ratio: float, apa: ReducedBody) -> FRF:
    scene = make_bench(payload_mass, "linear", damping_ratio=damping_ratio, apa=apa)
    record = simulate(scene, NOISE, time_step=1e-4, method="exact", progress=False)
    return estimate_frf(record, inputs=scene.inputs, outputs=scene.outputs, segment_duration=1.0)


def processor_time() -> float:
    """Return the CPU time of this process and of its ended children [s]."""
    return sum(os.times()[:4])


def nothing(n: float) -> float:
    return n


def overhead(n_runs: int, clocks: list[Callable[[], float]], **options: Any) -> dict[str, float]:
    """Measure runs without work: wall time, CPU time by the busiest of several clocks, and useful workers."""
    sweep(nothing, grid={"n": range(10)}, progress=False, **options)
    before = [clock() for clock in clocks]
    _, wall = timed(sweep, nothing, grid={"n": range(n_runs)}, progress=False, **options)
    cpu = max(clock() - begun for clock, begun in zip(clocks, before, strict=True)) / n_runs
    useful = {f"workers_{label.replace(' ', '_')}": duration / cpu for label, duration in DURATIONS.items()}
    return {"wall_s": wall / n_runs, "cpu_s": cpu, **useful}


def main() -> None:
    args = arguments.parse_args()
    work = functools.partial(bench, apa=reduced_apa300ml())
    rows = list(itertools.product(np.linspace(1.0, 10.0, args.runs // 4), (0.005, 0.01, 0.02, 0.05)))
    samples = {"payload_mass": [mass for mass, _ in rows], "damping_ratio": [ratio for _, ratio in rows]}
    _, start_time = timed(sweep, nothing, grid={"n": [0]}, n_processes=1, progress=False)
    clock = [processor_time()]
    loop, loop_time = timed(lambda: [work(mass, ratio).values for mass, ratio in rows])
    clock.append(processor_time())
    study, study_time = timed(sweep, work, samples=samples, n_processes=args.processes, progress=False)
    clock.append(processor_time())
    summary: dict[str, Any] = {"runs": len(rows), "processes": args.processes, "bench_s": loop_time / len(rows)}
    summary |= {"loop_s": loop_time, "study_s": study_time, "ratio": study_time / loop_time, "start_s": start_time}
    summary["quiet_ratio"] = (clock[2] - clock[1]) / args.processes / (clock[1] - clock[0])
    summary["difference"] = float(np.max(np.abs(study.frf.values - loop)))
    local = {"n_processes": args.processes}
    summary["overhead"] = {"child processes": overhead(args.empty_runs, [time.process_time], **local)}
    with cluster(args.processes) as (client, scheduler):
        clocks = [time.process_time, lambda: sum(scheduler.cpu_times()[:2])]
        summary["overhead"]["Dask"] = overhead(args.empty_runs, clocks, executor=client)
    print_report(REPORT, summary)
    print_table("overhead", summary["overhead"], COLUMNS)
    write_summary(args.output, summary)


if __name__ == "__main__":
    run(main)
