"""NGSolve and Netgen from threads, forked and spawned processes, and stopped by Ctrl-C: each in processes of its own.

Without the lock, without the check and without the thread that meshes, they crash, hang or wait.
"""

import json
import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest
from conftest import make_bar

from nassim import build_fe_model, craig_bampton
from nassim.base import library_lock
from nassim.base.library_lock import hold_library_lock
from nassim.fem import list_faces
from nassim.fem.cad_sizes import sizes_from_cad
from nassim.fem.meshing import generate_mesh
from nassim.fem.tessellation import face_surface, solid_surface

HERE = Path(__file__).parent
BARS = ((0.1, 0.01), (0.13, 0.017))


def reduce_bar(length, side):
    model = build_fe_model(make_bar(length, side), element_size=0.01, order=2, progress=False)
    return craig_bampton(model, n_modes=4, progress=False).eigenfrequencies()[6:]


ENVIRONMENT = {**os.environ, "NASSIM_THREADS": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}


def run(call, timeout=120):
    """Run a function of this file in another process; returns what it printed."""
    return subprocess.run(
        [sys.executable, "-c", f"import test_library_lock; test_library_lock.{call}"],
        cwd=HERE,
        env=ENVIRONMENT,
        capture_output=True,
        text=True,
        timeout=timeout,
        check=False,
    )


def in_two_threads():
    alone = [reduce_bar(*bar) for bar in BARS]
    with ThreadPoolExecutor(2) as pool:
        together = [pool.submit(reduce_bar, *bar) for _ in range(3) for bar in BARS]
        for k, future in enumerate(together):
            np.testing.assert_allclose(future.result(), alone[k % 2], rtol=1e-9)
    print("equal")


@pytest.mark.slow
def test_two_reductions_in_two_threads_equal_those_one_after_the_other():
    done = run("in_two_threads()")
    assert (done.returncode, done.stdout) == (0, "equal\n"), done.stderr


def test_outermost_call_holds_the_libraries():
    """Another thread waits for the end of the outermost block, not of an inner one."""
    order = []

    def other():
        with hold_library_lock():
            order.append("other")

    with hold_library_lock():
        with hold_library_lock(forkable=True):
            thread = threading.Thread(target=other)
            thread.start()
        thread.join(0.1)
        order.append("this")
    thread.join()
    assert order == ["this", "other"]


def put_bar(queue):
    try:
        queue.put(reduce_bar(*BARS[0]).tolist())
    except RuntimeError as error:
        queue.put(str(error))


def in_a_process(method, use):
    {"mesh": lambda: generate_mesh(make_bar(), element_size=0.02), "shape": make_bar}[use]()
    context = multiprocessing.get_context(method)
    queue = context.Queue()
    process = context.Process(target=put_bar, args=(queue,))
    process.start()
    try:
        print(queue.get(timeout=60))
    finally:
        process.kill()


@pytest.mark.skipif(not hasattr(os, "fork"), reason="there is no fork here")
def test_process_may_be_forked_before_ngsolve_is_used_and_not_after(monkeypatch):
    """Its frequencies are those of this process bit for bit, with one thread; more of them sum up in varying order."""
    monkeypatch.setenv("NASSIM_THREADS", "1")
    done = run("in_a_process('fork', 'shape'); test_library_lock.in_a_process('fork', 'mesh')")
    frequencies, _, refusal = done.stdout.partition("\n")
    assert frequencies.startswith("["), done.stdout + done.stderr
    np.testing.assert_array_equal(json.loads(frequencies), reduce_bar(*BARS[0]))
    assert "forked after its parent had used NGSolve" in refusal
    assert 'multiprocessing.get_context("spawn")' in refusal


def test_what_draws_faces_is_refused_in_a_forked_process_too(monkeypatch):
    """OpenCASCADE starts threads for it, without which it waits; shapes are made without them."""
    monkeypatch.setattr(library_lock, "_user", -1)
    solid = make_bar()
    for call, shape in (
        (list_faces, solid),
        (solid_surface, solid),
        (face_surface, solid.shape),
        (sizes_from_cad, solid),
    ):
        with pytest.raises(RuntimeError, match="forked after its parent had used NGSolve or OpenCASCADE"):
            call(shape)


def mesh_for_long():
    signal.signal(signal.SIGINT, signal.default_int_handler)  # shells have their background jobs ignore Ctrl-C
    solid = make_bar()
    print("begins", flush=True)
    try:
        generate_mesh(solid, element_size=2e-4)
    except KeyboardInterrupt:
        print("stopped", generate_mesh(solid, element_size=0.02).ne, flush=True)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="processes get no Ctrl-C from others there")
def test_ctrl_c_stops_netgen_and_leaves_it_in_order():
    """The mesh would take minutes; the one after it is as ever."""
    code = "import test_library_lock; test_library_lock.mesh_for_long()"
    with subprocess.Popen(
        [sys.executable, "-c", code], cwd=HERE, env=ENVIRONMENT, stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout.readline() == "begins\n"
            time.sleep(1.0)
            process.send_signal(signal.SIGINT)
            told, _ = process.communicate(timeout=25)
        finally:
            process.kill()
    assert told == f"stopped {generate_mesh(make_bar(), element_size=0.02).ne}\n"
