"""Compressed lines of long records against all lines: nothing is lost, and fits are the same."""

from dataclasses import replace

import numpy as np
import pytest

from nassim.identification import compressed_lines
from nassim.identification.compressed_lines import COMPRESSED_FROM, compress_lines
from nassim.identification.pole_fit import fit_poles, strongest_pole
from nassim.identification.spectral_lines import Lines

POLES = np.array([[61.0, 0.004], [150.0, 0.03], [151.5, 0.0005]])
VALUES = np.array([[1.0, -0.3, 0.02], [0.2, 0.5, -0.01]])


def lines_of(poles, n=COMPRESSED_FROM + 500, *, hold_order=0, smooth=False, band=(5.0, 200.0)):
    """A record's lines with transients, and the values of all columns; smooth: as of a sweep, else as of noise."""
    random = np.random.default_rng(2)
    omega = 2 * np.pi * np.linspace(*band, n)
    noise = random.normal(size=n) + 1j * random.normal(size=n)
    empty = Lines(
        omega=omega,
        excitation=np.exp(1e-3j * omega**1.5) if smooth else noise,
        responses=np.zeros((2, n), dtype=complex),
        time_step=1e-3,
        transient=True,
        hold_order=hold_order,
        residual_powers=(0, 1, 2, -2),
    )
    columns = empty.columns(poles)
    values = random.normal(size=(2, columns.shape[1])) / np.linalg.norm(columns, axis=0)
    values[:, : len(poles)] = VALUES[:, : len(poles)]
    return replace(empty, responses=values @ columns.T), values


@pytest.mark.parametrize("smooth", [False, True])
@pytest.mark.parametrize("hold_order", [None, 0, 1])
def test_compressed_lines_hold_all_that_the_model_says(hold_order, smooth):
    """At every line, near a mode of five lines' width too, from an eighth of the numbers or less."""
    lines, values = lines_of(POLES, hold_order=hold_order, smooth=smooth)
    few = compress_lines(lines, POLES)
    assert few.responses.shape[1] < len(lines.omega) / 4
    ends = [(cell.lines.start, cell.lines.stop) for cell in few.cells]
    assert [0, *(stop for _, stop in ends)] == [*(start for start, _ in ends), len(lines.omega)]
    np.testing.assert_allclose(few.modelled(POLES, values), lines.responses, atol=1e-10 * np.abs(lines.responses).max())
    # What is compressed of the responses is what the columns make of their values, and no energy is left out.
    np.testing.assert_allclose(values @ few.columns(POLES).T, few.responses, atol=1e-9 * np.abs(few.responses).max())
    assert np.linalg.norm(few.responses) == pytest.approx(np.linalg.norm(lines.responses), rel=1e-10)


def test_a_fit_of_compressed_lines_is_that_of_all(monkeypatch):
    """Poles to some hundredths of their deviations, which are the same, with noise that rises within the cells."""
    lines, _ = lines_of(POLES[:2], n=5000)
    monkeypatch.setattr(compressed_lines, "COMPRESSED_FROM", 2000)
    random = np.random.default_rng(5)
    noise = np.geomspace(0.1, 0.5, len(lines.omega)) * np.array([[1.0], [2.0]])
    random_part = random.normal(size=(2, *noise.shape)) / np.sqrt(2)
    lines = replace(lines, responses=lines.responses + noise * (random_part[0] + 1j * random_part[1]))
    start, weights = POLES[:2] * [[1.01, 2.0], [0.99, 0.6]], np.sqrt(2) / noise
    few = fit_poles(lines, start, weights)
    monkeypatch.setattr(compressed_lines, "COMPRESSED_FROM", 10**9)
    whole = fit_poles(replace(lines), start, weights)
    deviations = np.sqrt(np.diag(whole.covariance))
    np.testing.assert_allclose(np.sqrt(np.diag(few.covariance)), deviations, rtol=5e-3)
    assert np.abs(np.log(few.poles / whole.poles).T.ravel() / deviations[:4]).max() < 2e-2
    assert np.abs((few.values - whole.values).ravel() / deviations[4:]).max() < 0.1
    np.testing.assert_allclose(few.residual, lines.responses - few.values @ lines.columns(few.poles).T, atol=1e-10)


def test_the_covariance_is_that_of_all_unknowns_at_once():
    """(J^T J)^-1 by difference quotients of the weighted model, of overlapping modes, whose unknowns are correlated."""
    lines, values = lines_of(np.array([[150.0, 0.01], [151.0, 0.004]]), n=400, band=(100.0, 200.0))
    weights = np.geomspace(1.0, 3.0, 400) * np.array([[1.0], [2.0]])
    fitted = fit_poles(lines, np.array([[150.0, 0.01], [151.0, 0.004]]), weights)
    n = fitted.poles.size
    unknowns = np.concatenate([np.log(fitted.poles.T.ravel()), fitted.values.ravel()])

    def modelled(unknowns):
        poles, linear = np.exp(unknowns[:n]).reshape(2, -1).T, unknowns[n:].reshape(values.shape)
        result = weights * (linear @ lines.columns(poles).T)
        return np.concatenate([result.real, result.imag]).ravel()

    steps = 1e-5 * np.maximum(np.abs(unknowns), 0.1 * np.abs(unknowns).max())
    steps[:n] = 1e-6
    jacobian = [(modelled(unknowns + h) - modelled(unknowns - h)) / (2 * h.max()) for h in np.diag(steps)]
    covariance = np.linalg.inv(np.array(jacobian) @ np.array(jacobian).T)
    size = np.sqrt(np.outer(np.diag(covariance), np.diag(covariance)))
    assert np.abs(covariance / size - np.eye(len(size)))[:n, :n].max() > 0.5
    np.testing.assert_allclose(fitted.covariance / size, covariance / size, atol=1e-4)


def test_cells_follow_the_poles():
    """Those near a pole that a fit has moved are made anew, the others kept."""
    lines, values = lines_of(POLES)
    before = compress_lines(lines, POLES[:1])
    after = compress_lines(lines, POLES)
    kept = {id(cell) for cell in before.cells} & {id(cell) for cell in after.cells}
    assert 0 < len(kept) < len(after.cells)
    np.testing.assert_allclose(
        after.modelled(POLES, values), lines.responses, atol=1e-10 * np.abs(lines.responses).max()
    )


def test_few_lines_and_those_of_frfs_stay_as_they_are():
    lines, _ = lines_of(POLES, n=COMPRESSED_FROM - 1)
    assert compress_lines(lines, POLES) is lines
    frf = replace(lines_of(POLES)[0], transient=False)
    assert compress_lines(frf, POLES) is frf


def test_the_strongest_pole_among_many_lines():
    """Lines that are taken as one where they are close together: the resonance is found, to its half-width."""
    lines, _ = lines_of(POLES[:1], n=5 * COMPRESSED_FROM)
    lines = replace(lines, responses=lines.mode(POLES[0]) * lines.excitation * np.array([[1.0], [-0.2]]))
    found = strongest_pole(lines, lines.responses, np.ones(lines.responses.shape))
    assert found[0] == pytest.approx(POLES[0, 0], rel=0.01)
    assert found[1] == 0.003
