"""Multisines for several inputs: over the blocks, no input holds anything of another."""

import numpy as np
import pytest

from nassim.signals import orthogonal_multisines, remove_settling


@pytest.mark.parametrize("n", [2, 3, 5])
def test_inputs_are_orthogonal_over_the_blocks(n):
    rate, period = 200.0, 1.0
    signal = orthogonal_multisines(
        [f"u{k}" for k in range(n)], rate, lowest_frequency=3, highest_frequency=40, period=period, rms=0.7, seed=3
    )
    settled = remove_settling(signal, duration=3 * period, settling=period)
    spectra = np.fft.rfft(settled.values.reshape(n, n, 2, -1), axis=-1)[:, :, 0, 3:41]
    power = np.einsum("ibf,jbf->fij", spectra, spectra.conj())
    np.testing.assert_allclose(power / power[0, 0, 0].real, np.broadcast_to(np.eye(n), power.shape), atol=1e-9)
    assert np.sqrt(np.mean(settled.values**2, axis=1)) == pytest.approx(0.7)
    # The sample at the end of the record goes on with its last block.
    np.testing.assert_allclose(signal.values[:, -1], settled.values[:, -200])


def test_what_is_left_of_blocks_keeps_the_record_s_time():
    signal = orthogonal_multisines(["a", "b"], 100.0, lowest_frequency=2, highest_frequency=9, period=1.0)
    later = type(signal)(signal.time + 5.0, signal.values, signal.names, signal.units)
    assert remove_settling(later, duration=3.0, settling=1.0).time[0] == 5.0
