"""C code of a model's exact steps: two files of plain C99 without dynamic memory, for a target or another program."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import nassim
from nassim.base.short_repr import short_repr
from nassim.base.storage import write_atomically
from nassim.exchange.c_tables import PRODUCT, CNumbers, CTables, array, as_identifiers, checked_identifier, comment
from nassim.exchange.programs import Exported
from nassim.scene.scene import Scene
from nassim.systems.linear_model import LinearModel
from nassim.systems.step_program import Converter, ProgramSignal, StepProgram, run_program

NOISE_SAMPLES = 2000
"""Number of samples of the run that tells the error of single precision."""


@dataclass(frozen=True, kw_only=True)
class CCode:
    """Files written by `export_c`, with operations and memory of a step.

    Attributes:
        header: file of the types and functions.
        source: file of the tables and of the functions' bodies.
        step_operations: largest number of multiplications and of additions of a step.
        output_operations: the same of an output.
        constant_bytes: memory of the constants.
        state_bytes: memory of what changes, which the caller holds.
        stack_bytes: memory of local numbers of a step.
        errors: in single precision, the largest error of each output over its largest value, in a run of 2000 samples
            with noise on every input, whose mean and standard deviation are its typical magnitude; empty in double
            precision.
    """

    header: Path
    source: Path
    step_operations: int
    output_operations: int
    constant_bytes: int
    state_bytes: int
    stack_bytes: int
    errors: Mapping[str, float]
    __repr__ = short_repr

    def __str__(self) -> str:
        """Describe the files in a few lines."""
        lines = [
            f"{self.header.name}, {self.source.name} in {self.header.parent}: at most {self.step_operations} "
            f"multiplications and as many additions a step, {self.output_operations} an output; "
            f"{self.constant_bytes} bytes of constants, {self.state_bytes} of state, {self.stack_bytes} of stack"
        ]
        if self.errors:
            worst = max(self.errors, key=self.errors.__getitem__)
            lines.append(f"single precision: errors up to {self.errors[worst]:.2g} of the largest value, of {worst}")
        return "\n".join(lines)


def export_c(
    model: LinearModel | Scene,
    folder: str | Path,
    name: str,
    *,
    time_step: float | None = None,
    hold_order: int = 0,
    precision: str = "double",
    start: str = "equilibrium",
    constant_inputs: Mapping[str, float] | None = None,
    input_sizes: Mapping[str, float] | None = None,
    allow_unstable: bool = False,
) -> CCode:
    """Write the exact steps of a linear model or a scene as C99, to `name.h` and `name.c` in a folder.

    The functions are `name_init`, `name_output` and `name_step`. The caller holds the state, a plain struct, so there
    may be any number of models at once. At each sample, `name_output` gives the outputs for the present inputs and
    `name_step` goes on to the next sample. The numbers are those of `simulate(..., method="exact")`.

    Args:
        model: a linear model, or a scene with its loops, which gives outputs and then the commands of its loops.
        folder: where the files are written.
        name: name of the files and prefix of all names in them, an identifier of C.
        time_step: time between samples [s]; None for that of a sampled model, or of the fastest loop of a scene.
        hold_order: 0 for inputs that keep the value of each sample until the next, as from a converter; 1 for inputs
            that run straight between samples, of which each output then has the present value.
        precision: "double" or "single".
        start: of a scene, "equilibrium" or "released", see `simulate`.
        constant_inputs: of a scene, constant values of inputs that act beside the inputs, by name, see `simulate`.
        input_sizes: typical magnitudes of inputs, by name, for the error of single precision; 1 for others.
        allow_unstable: whether a model whose motion grows is written.

    Returns:
        What was written, with the number of operations and the memory; `print` shows it.

    Raises:
        ValueError: for a name that is no identifier; for a scene that exact steps refuse, such as one in floating
            frames; for a controller in Python; for a model that is unstable; for arguments out of range.
    """
    checked_identifier(name)
    numbers = CNumbers(precision)
    exported = Exported(
        source=model,
        start=start,
        constant_inputs=constant_inputs,
        input_sizes=input_sizes,
        allow_unstable=allow_unstable,
    )
    program = exported.steps(time_step, hold_order)
    code = StepCode.of(program, name, numbers)
    errors = single_precision_errors(program) if precision == "single" else {}
    target = Path(folder)
    written = CCode(
        header=target / f"{name}.h",
        source=target / f"{name}.c",
        step_operations=code.step_operations,
        output_operations=code.output_operations,
        constant_bytes=code.constant_bytes,
        state_bytes=code.state_bytes,
        stack_bytes=code.stack_bytes,
        errors=errors,
    )
    for path, text in ((written.source, code.source), (written.header, code.header)):
        with write_atomically(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return written


def single_precision_errors(program: StepProgram) -> dict[str, float]:
    """Return the largest error of each output in single precision over its largest value, see `CCode`."""
    sizes = np.array([[signal.size] for signal in program.inputs]).reshape(-1, 1)
    noise = sizes * (1.0 + np.random.default_rng(0).normal(size=(len(program.inputs), NOISE_SAMPLES)))
    exact, rounded = run_program(program, noise), run_program(program, noise, precision=np.float32)
    largest = np.abs(exact).max(axis=1)
    errors = np.abs(rounded - exact).max(axis=1) / np.where(largest > 0, largest, 1.0)
    return {signal.name: float(error) for signal, error in zip(program.outputs, errors, strict=True)}


@dataclass(frozen=True, kw_only=True)
class StepCode:
    """C code of a program and what it costs; see `CCode`.

    Attributes:
        header: text of the header.
        source: text of the source.
        step_operations: multiplications of a step, at most.
        output_operations: multiplications of an output, at most.
        constant_bytes: memory of the constants.
        state_bytes: memory of the state.
        stack_bytes: memory of local numbers.
    """

    header: str
    source: str
    step_operations: int
    output_operations: int
    constant_bytes: int
    state_bytes: int
    stack_bytes: int

    @classmethod
    def of(cls, program: StepProgram, name: str, numbers: CNumbers) -> "StepCode":
        """Write a program, with a prefix of all names and a precision."""
        tables = _tables(program, numbers)
        named = {table.name: table for table in tables}
        n, raw, split = program.n_states, len(program.reading), program.n_measured
        busy = sum(named[key].entries for key in ("reading", "through", "reference", "gains")) + 2 * raw
        step = busy + sum(named[key].entries for key in ("by_states", "by_input", "by_converted", "by_excess"))
        output = busy + sum(named[key].entries for key in ("shown", "direct", "held", "set"))
        body = _body(program, named)
        fields = {
            "name": name,
            "NAME": name.upper(),
            "real": numbers.kind,
            "by": f"nassim {nassim.__version__}",
            "time_step": repr(program.time_step),
            "n_in": len(program.inputs),
            "n_out": len(program.outputs),
            "n": n,
            "places": max(n, 1),
            "n_step": step,
            "n_output": output,
        }
        header = HEADER.format(
            **fields,
            inputs=_places(f"{name.upper()}_U", program.inputs),
            outputs=_places(f"{name.upper()}_Y", program.outputs),
        )
        kinds = 4 * (len(program.phases) + len(program.samples)) if raw else 0
        constants = sum(table.bytes for table in tables) + numbers.size * (n + 3 * raw - split) + kinds
        source = SOURCE.format(
            **fields,
            product=PRODUCT if any(table.text for table in tables) else "",
            tables="\n".join(table.text for table in tables if table.text),
            start=array("real", "start", [numbers.literal(value) for value in program.start.tolist()]),
            sampling=_sampling(program, named, numbers),
            **body,
        )
        return cls(
            header=header,
            source=source,
            step_operations=step,
            output_operations=output,
            constant_bytes=constants,
            state_bytes=numbers.size * (max(n, 1) + 1),
            stack_bytes=numbers.size * (n + raw + raw - split),
        )


def _tables(program: StepProgram, numbers: CNumbers) -> list[CTables]:
    n, samples, kept = program.n_states, program.samples, program.commands
    matrices = {
        "by_input_at_start": [program.start_by_inputs],
        "by_states": [one.state[:, :n] for one in samples],
        "by_converted": [one.state[:, n:] for one in samples],
        "by_input": [program.taken],
        "by_excess": [one.corrections for one in samples],
        "shown": [one.outputs for one in samples],
        "direct": [program.feedthrough],
        "held": [one.state[kept, :n] for one in samples],
        "set": [one.state[kept, n:] for one in samples],
        "reading": [program.reading],
        "through": [program.through],
        "reference": [-program.reference],
        "gains": [program.gains],
    }
    return [CTables.of(name, found, numbers) for name, found in matrices.items()]


def _places(prefix: str, signals: tuple[ProgramSignal, ...]) -> str:
    """Return the definitions of the places of signals, with their names, units and descriptions."""
    lines = []
    for k, (signal, identifier) in enumerate(zip(signals, as_identifiers([s.name for s in signals]), strict=True)):
        unit = f" [{signal.unit}]" if signal.unit else ""
        more = f": {signal.description}" if signal.description else ""
        lines.append(f"#define {prefix}_{identifier.upper()} {k}  /* {comment(signal.name + unit + more)} */")
    return "\n".join(lines)


def _body(program: StepProgram, tables: dict[str, CTables]) -> dict[str, str]:
    """Return the statements of the three functions."""
    raw = bool(program.converters)
    n_shown = len(program.feedthrough)
    kind = "kind" if raw else "0"
    sample = (
        "    const int kind = kinds[s->sample];\n"
        f"    real raw[{len(program.reading)}] = {{0}}, excess[{len(program.gains)}] = {{0}};\n"
        "    if (due[kind])\n        take_sample(s->x, u, raw, excess);\n"
        if raw
        else ""
    )
    step = (
        tables["by_states"].product("s->x", "next", kind)
        + tables["by_input"].product("u", "next")
        + tables["by_converted"].product("raw", "next", kind)
        + tables["by_excess"].product("excess", "next", kind)
    )
    output = tables["shown"].product("s->x", "y", kind) + tables["direct"].product("u", "y")
    if raw:
        output += tables["held"].product("s->x", f"y + {n_shown}", kind) + tables["set"].product(
            "raw", f"y + {n_shown}", kind
        )
    period = len(program.phases)
    return {
        "init": tables["by_input_at_start"].product("u", "s->x"),
        "step": sample + step,
        "output": sample + output,
        "count": f"    s->sample = (s->sample + 1) % {period};\n" if period > 1 else "",
    }


def _sampling(program: StepProgram, tables: dict[str, CTables], numbers: CNumbers) -> str:
    """Return the C code of a sample of the controllers; empty without controllers."""
    if not program.converters:
        return ""
    split = program.n_measured

    def largest(converter: Converter) -> float:
        return converter.largest_count if converter.step else converter.limit

    computed = len(program.converters) - split
    return SAMPLING.format(
        kinds=array("int", "kinds", list(map(str, program.phases))),
        due=array("int", "due", [str(int(one.due)) for one in program.samples]),
        steps=array("real", "steps", [numbers.literal(c.step) for c in program.converters]),
        most=array("real", "most", [numbers.literal(largest(c)) for c in program.converters]),
        limits=array("real", "limits", [numbers.literal(c.limit) for c in program.converters[split:]]),
        split=split,
        raw=len(program.converters),
        computed=computed,
        shift=numbers.literal(1.5 * 2.0 ** (52 if numbers.precision == "double" else 23)),
        reading=tables["reading"].product("x", "raw"),
        through=tables["through"].product("u", "raw"),
        reference=tables["reference"].product("u", "raw"),
        gains=tables["gains"].product("raw", f"raw + {split}"),
    )


HEADER = """\
/* {name}: exact steps of a model. Made by {by}; do not edit.

   At each sample: {name}_output(&state, u, y), then {name}_step(&state, u).
   At most {n_step} multiplications and as many additions a step, {n_output} an output. */
#ifndef {NAME}_H
#define {NAME}_H

#ifdef __cplusplus
extern "C" {{
#endif

typedef {real} {name}_real;

#define {NAME}_TIME_STEP {time_step}  /* time between samples [s] */
#define {NAME}_INPUTS {n_in}
#define {NAME}_OUTPUTS {n_out}
#define {NAME}_STATES {n}

/* Places of the inputs in u */
{inputs}

/* Places of the outputs in y */
{outputs}

typedef struct {{
    {name}_real x[{places}];  /* states */
    int sample;  /* number of the sample in the period of the controllers */
}} {name}_state;

/* Begin, with the inputs of the first sample. */
void {name}_init({name}_state *s, const {name}_real u[]);

/* Give the outputs at this sample, for its inputs. The state does not change. */
void {name}_output(const {name}_state *s, const {name}_real u[], {name}_real y[]);

/* Go on to the next sample, with the inputs of this one. */
void {name}_step({name}_state *s, const {name}_real u[]);

#ifdef __cplusplus
}}
#endif

#endif
"""

SOURCE = """\
/* {name}: exact steps of a model. Made by {by}; do not edit. */
#include "{name}.h"

#include <math.h> /* for HUGE_VAL alone; no library of functions is needed */
#include <string.h>

typedef {name}_real real;

{product}
{start}
{tables}
{sampling}
void {name}_init({name}_state *s, const real u[])
{{
    memcpy(s->x, start, sizeof start);
    s->sample = 0;
    (void)u;
{init}}}

void {name}_output(const {name}_state *s, const real u[], real y[])
{{
    (void)s;
    (void)u;
    memset(y, 0, {n_out} * sizeof *y);
{output}}}

void {name}_step({name}_state *s, const real u[])
{{
    real next[{places}] = {{0}};
    (void)u;
{step}    memcpy(s->x, next, sizeof next);
{count}}}
"""

SAMPLING = """\
/* Kind of each sample of the period, and the kinds at which a controller is due */
{kinds}{due}
/* Resolution of each converter, 0 for none; its largest count, or its limit; and the limits of the controllers */
{steps}{most}{limits}
static real limited(real value, real limit)
{{
    return value > limit ? limit : value < -limit ? -limit : value;
}}

/* Round to the nearest whole number, ties to even: beyond the shift numbers have no fraction. */
static real rounded(real value)
{{
    volatile real shifted = value + {shift};
    return shifted - {shift};
}}

static real converted(real value, int k)
{{
    return steps[k] > 0 ? steps[k] * limited(rounded(value / steps[k]), most[k]) : limited(value, most[k]);
}}

/* Find what the controllers read and command, and what limits take from the commands. */
static void take_sample(const real *x, const real *u, real *raw, real *excess)
{{
    int k;
    (void)u;
{reading}{through}    for (k = 0; k < {split}; k++)
        raw[k] = converted(raw[k], k);
{reference}{gains}    for (k = 0; k < {computed}; k++) {{
        excess[k] = limited(raw[{split} + k], limits[k]) - raw[{split} + k];
        raw[{split} + k] = converted(raw[{split} + k], {split} + k);
    }}
}}
"""
