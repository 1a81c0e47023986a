"""Work of growing size and what it costs on one thread, for benchmark_scaling.py."""

from functools import partial

import netgen.occ  # noqa: F401  (before ngsolve: loads the CAD kernel)
import ngsolve as ng
import numpy as np
from _costs import cpu_time, peak_memory
from _limits import held_unknowns
from _reduction_routes import N_MODES, N_SOLVES
from _scaling_steps import TURNS, states, struts
from _signal_rows import RATE, SIGNALS

from models.apa300ml import make_apa300ml, reduced_apa300ml
from models.bench import make_bench
from nassim import Scene, craig_bampton, estimate_frf, identify_modes, simulate
from nassim.fem import assemble_mesh, generate_mesh
from nassim.fem.solver import factorize
from nassim.signals import band_limited_noise

BLOCK = 16
"""Columns that are solved at once."""
MANY = 1_000_000
"""Samples beyond which once is enough."""


def measure(kind: str, size: float) -> dict[str, float]:
    """CPU times of work of a kind and size, the process's largest memory, and how far that grew [bytes]."""
    before = peak_memory()
    figures = WORKS[kind](size)
    memory = peak_memory()
    return {**figures, "memory_B": memory, "grown_B": memory - before}


def reduction(element_size: float) -> dict[str, float]:
    """The APA300ML's reduction from the mesh on, of order 2 with rbe2, then what it spends in the solver alone."""
    solid = make_apa300ml(coupling="rbe2", stack_coupling="rbe2")
    mesh = ng.Mesh(generate_mesh(solid, element_size=1e-3 * element_size, curvature=0.5))
    mesh.Curve(2)
    model, assembly = cpu_time(assemble_mesh, mesh, solid, 2)
    reducing = cpu_time(craig_bampton, model, n_modes=N_MODES, progress=False)[1]
    factor, factorisation = cpu_time(factorize, model.stiffness, held=held_unknowns(model))
    block = np.random.default_rng(0).standard_normal((model.n_dofs, BLOCK))
    widths = [min(BLOCK, N_SOLVES - start) for start in range(0, N_SOLVES, BLOCK)]
    solving = cpu_time(lambda: [factor.solve(block[:, :width]) for width in widths])[1]
    return {
        "size": model.n_dofs // 3,
        "reduction_s": assembly + reducing,
        "factorisation_s": factorisation,
        "solves_s": solving,
    }


def samples(count: float) -> dict[str, float]:
    """A record of the bench simulated, its FRFs estimated, its mode identified: all in one process."""
    bench = make_bench(apa=reduced_apa300ml(progress=False), fidelity="linear")
    signals(bench, 20_000)  # loads what is loaded when it is used
    turns = [signals(bench, round(count)) for _ in range(TURNS if count <= MANY else 1)]
    return {key: min(turn[key] for turn in turns) for key in turns[0]}


def signals(bench: Scene, count: int) -> dict[str, float]:
    """The same once."""
    noise = band_limited_noise(count / RATE, RATE, cutoff_frequency=300.0, rms=1e-3)
    record, simulating = cpu_time(simulate, bench, noise, time_step=1 / RATE, method="exact", progress=False)
    inputs, outputs = [SIGNALS["input"]], SIGNALS["outputs"]
    estimating = cpu_time(estimate_frf, record, inputs=inputs, outputs=outputs, segment_duration=1.0)[1]
    identify = partial(identify_modes, band=(20.0, 300.0), hold_order=1, n_modes=1)
    return {
        "size": len(record.time),
        "simulate_s": simulating,
        "estimate_frf_s": estimating,
        "identify_modes_s": cpu_time(identify, record, **SIGNALS)[1],
    }


WORKS = {"nodes": reduction, "struts": struts, "states": states, "samples": samples}
