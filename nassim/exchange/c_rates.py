"""C code of a continuous linear model: rates of the states and outputs, for solvers of other programs."""

from dataclasses import dataclass

import nassim
from nassim.exchange.c_tables import PRODUCT, CNumbers, CTables, array
from nassim.systems.step_program import RateProgram


@dataclass(frozen=True)
class RateCode:
    """C code of a continuous program.

    Attributes:
        header: text of the header.
        source: text of the source.
    """

    header: str
    source: str

    @classmethod
    def of(cls, program: RateProgram, name: str) -> "RateCode":
        """Write a program in double precision, with a prefix of all public names."""
        numbers = CNumbers()
        by_state, by_input, shown, direct = tables = tuple(
            CTables.of(key, [matrix], numbers)
            for key, matrix in zip(("by_state", "by_input", "shown", "direct"), program.matrices, strict=True)
        )
        fields = {
            "name": name,
            "NAME": name.upper(),
            "by": f"nassim {nassim.__version__}",
            "n": len(program.start),
            "n_in": len(program.inputs),
            "n_out": len(program.outputs),
        }
        source = SOURCE.format(
            **fields,
            product=PRODUCT if any(table.text for table in tables) else "",
            tables="\n".join(table.text for table in tables if table.text),
            start=array("real", "start", [numbers.literal(value) for value in program.start.tolist()]),
            sizes=array("real", "sizes", [numbers.literal(value) for value in program.sizes.tolist()]),
            rates=by_state.product("x", "dx") + by_input.product("u", "dx"),
            output=shown.product("x", "y") + direct.product("u", "y"),
        )
        return cls(HEADER.format(**fields), source)


HEADER = """\
/* {name}: rates and outputs of a continuous linear model. Made by {by}; do not edit. */
#ifndef {NAME}_H
#define {NAME}_H

#define {NAME}_INPUTS {n_in}
#define {NAME}_OUTPUTS {n_out}
#define {NAME}_STATES {n}

/* Give the states at the start, and their typical magnitudes. */
void {name}_init(double x[], double size[]);

/* Give the rates of the states. */
void {name}_rates(const double x[], const double u[], double dx[]);

/* Give the outputs. */
void {name}_output(const double x[], const double u[], double y[]);

#endif
"""

SOURCE = """\
/* {name}: rates and outputs of a continuous linear model. Made by {by}; do not edit. */
#include "{name}.h"

#include <string.h>

typedef double real;

{product}
{start}{sizes}
{tables}
void {name}_init(double x[], double size[])
{{
    memcpy(x, start, {n} * sizeof *x);
    memcpy(size, sizes, {n} * sizeof *size);
}}

void {name}_rates(const double x[], const double u[], double dx[])
{{
    (void)x;
    (void)u;
    memset(dx, 0, {n} * sizeof *dx);
{rates}}}

void {name}_output(const double x[], const double u[], double y[])
{{
    (void)x;
    (void)u;
    memset(y, 0, {n_out} * sizeof *y);
{output}}}
"""
