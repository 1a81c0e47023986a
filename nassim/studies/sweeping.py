"""Sweeps: one function, many parameters, labelled results, by the same call on one machine or on a cluster."""

import importlib
import os
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from nassim.base.checks import frozen_mapping, known, positive, whole_number
from nassim.base.progress import stage
from nassim.studies.dataset import to_dataset
from nassim.studies.executors import Outcomes, Requests, run_in_children, run_on_executor, run_serially
from nassim.studies.job import Function, Job, identity, label, make_job, pickle_task
from nassim.studies.outcome import OK, UNFINISHED
from nassim.studies.plan import Plan, make_plan, run_key
from nassim.studies.results import STATUS
from nassim.studies.run_store import Records, open_records
from nassim.studies.samples import Samples

if TYPE_CHECKING:
    import xarray

SERIAL = "serial"


def sweep(
    function: Function,
    *,
    grid: Mapping[str, Any] | None = None,
    samples: Samples | Mapping[str, Any] | None = None,
    executor: Any = None,
    folder: str | Path | None = None,
    seed: int | None = None,
    units: Mapping[str, str] | None = None,
    time_limit: float | None = None,
    n_processes: int | None = None,
    retry: Collection[str] = (),
    progress: bool = True,
) -> "xarray.Dataset":
    """Call a function with many parameters and return all results with labels.

    A run that fails does not stop the study. Its numbers are NaN (those of a diverged run are as returned). The folder
    also contains the finished runs after Ctrl-C. `results.to_netcdf("study.nc", engine="h5netcdf")` saves results with
    complex numbers.

    Args:
        function: takes the parameters of one run by keyword and returns a number, an array, an `FRF`, a `TimeHistory`,
            or a mapping of names to these. Its printed output is shown by `executor="serial"` only. Large common inputs
            are fixed by `functools.partial(function, body=body)` (or are closure variables) and are sent once per
            process.
        grid: values by name of the parameter; all combinations are run. Give either `grid` or `samples`.
        samples: one row per run, from a sampling plan, or equally long lists of values by name.
        executor: None for child processes on this machine; a `dask.distributed.Client` or another object with a method
            `submit`, whose workers then carry out the runs in child processes; "serial" for one run after the other in
            this process.
        folder: folder in which every finished run is stored. The same call after an interruption carries out only the
            remaining runs, and so does a call with more points. None: memory only.
        seed: seed of the study. The seed of a run follows from it and from the parameters of the run, and is passed to
            the parameter `seed` of the function.
        units: units of parameters and results by name, for `attrs["units"]` of the results.
        time_limit: time limit of each run, after which it is stopped [s].
        n_processes: number of processes on this machine (default: the number of available processors).
        retry: states of stored runs that are repeated: "failed", "diverged", "timed out", "lost".
        progress: print the progress.

    Returns:
        `xarray.Dataset`. Its dimensions are the parameters of the grid, or `run` with the values of the samples along
        it, then those of the results (`frequency`, `output`, `input` of an FRF, `time`, `signal` of a history,
        `name_0`, ... of arrays). The status of each run in `status` is "ok", "failed" (the function raised an
        exception: see `message`, and the manifest in the folder), "diverged" (it returned NaN), "timed out", "lost"
        (its process ended three times), or "other shape" (than the results of most runs). `wall_time` is the duration
        of the function [s].

    Raises:
        ValueError: before the first run, for unknown or missing parameters, a grid without runs, samples of unequal
            length, equal samples with a seed, a function that cannot be pickled, a folder of another study.
        ImportError: without the extra `studies`.
        RuntimeError: for an executor that breaks.
    """
    _check_extra()
    plan = make_plan(grid, samples)
    job = make_job(function, tuple(plan.values), seed)
    _check_seeds(plan, job)
    repeated = {known("state of a run", state, UNFINISHED) for state in _texts(retry)}
    carry_out = _choose_executor(job, executor, time_limit, n_processes)
    place = None if folder is None else Path(folder)
    with open_records(place, identity(job) if place else {}) as records:
        _run_all(plan, job, records, carry_out, repeated, place, progress)
        attributes: dict[str, Any] = {"function": label(function), "plan": plan.label}
        attributes |= {} if job.seed is None else {"seed": job.seed}
        study = to_dataset(plan, records, frozen_mapping(units), attributes)
    if progress:
        _print_failures([str(status) for status in study[STATUS].values.flat])
    return study


def _check_seeds(plan: Plan, job: Job) -> None:
    """Refuse rows of samples that would be one run with one seed."""
    n_runs = len(set(map(run_key, plan.runs()))) if job.seed is not None else len(plan)
    if n_runs < len(plan):
        raise ValueError(
            f"{len(plan)} rows of samples are {n_runs} different runs, and a run's seed follows from its parameters: "
            "equal rows would have equal results; add a parameter that numbers them"
        )


def _choose_executor(job: Job, executor: Any, time_limit: float | None, n_processes: int | None) -> Any:
    """Return the function that carries out the runs, after a check of the options."""
    limit = None if time_limit is None else positive("time_limit", time_limit, "s")
    count = _processors() if n_processes is None else whole_number("n_processes", n_processes, 1)
    if n_processes is not None and executor is not None:
        raise ValueError(f"with n_processes, executor must be None; got {executor!r:.60}")
    if executor == SERIAL and isinstance(executor, str):
        if limit is not None:
            raise ValueError(
                'executor="serial" carries out runs in this process, which cannot be stopped: leave out time_limit'
            )
        return lambda requests: run_serially(job.task, requests)
    if executor is not None and not callable(getattr(executor, "submit", None)):
        raise ValueError(f'executor must be None, "serial" or have a method submit, got {executor!r:.60}')
    if getattr(executor, "asynchronous", False):
        raise ValueError("the Dask client is asynchronous; a study needs one made by Client(address)")
    payload = pickle_task(job)
    if executor is not None:
        return lambda requests: run_on_executor(payload, requests, limit, executor)
    return lambda requests: run_in_children(payload, requests, limit, count)


def _run_all(
    plan: Plan,
    job: Job,
    records: Records,
    carry_out: Any,
    repeated: Collection[str],
    folder: Path | None,
    progress: bool,
) -> None:
    """Carry out the runs that are not in the records."""
    waiting = {run_key(parameters): parameters for parameters in plan.runs()}
    n_all = len(waiting)
    for key, record in records.runs.items():
        if record.status not in repeated:
            waiting.pop(key, None)
    n_waiting, n_done = len(waiting), 0
    if progress and n_waiting < n_all:
        print(f"  {n_all - n_waiting} of {n_all} runs are in {folder}", flush=True)
    if not waiting:
        return
    requests: Requests = ((key, job.arguments(parameters, key)) for key, parameters in waiting.items())
    outcomes: Outcomes = carry_out(requests)
    try:
        with stage("study", total=n_waiting, unit="runs", enabled=progress) as advance:
            for key, outcome in outcomes:
                records.add(key, waiting[key], outcome)
                n_done += 1
                advance()
    except KeyboardInterrupt:
        kept = f"the same call goes on from {folder}" if folder else "without folder= they are lost"
        raise KeyboardInterrupt(f"stopped after {n_done} of {n_waiting} runs; {kept}") from None
    finally:
        outcomes.close()


def _print_failures(statuses: list[str]) -> None:
    listed = [f"{statuses.count(status)} {status}" for status in dict.fromkeys(statuses) if status != OK]
    if listed:
        print(f"  {statuses.count(OK)} runs ok, {', '.join(listed)}: see the results' status and message", flush=True)


def _texts(retry: Collection[str]) -> tuple[str, ...]:
    return (retry,) if isinstance(retry, str) else tuple(retry)


def _processors() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _check_extra() -> None:
    for module in ("xarray", "cloudpickle"):
        try:
            importlib.import_module(module)
        except ImportError as error:
            raise ImportError(f'studies need {module}: pip install "nassim[studies]"') from error
