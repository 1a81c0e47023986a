"""Geometric stiffness in files of earlier formats."""

import h5py
import numpy as np
import pytest

from nassim import load, save
from nassim.base import storage
from nassim.bodies import StressStiffness


def test_an_earlier_file_has_the_sum_of_the_terms_and_says_so(tmp_path):
    """Up to format 3, one array "matrices" held stress and change of shape together."""
    matrices = np.random.default_rng(3).standard_normal((13, 4, 4))
    matrices = matrices + matrices.transpose(0, 2, 1)
    path = save(StressStiffness(np.eye(13, 4), matrices, 0 * matrices), tmp_path / "stress.h5")
    with h5py.File(path, "a") as file:
        file.attrs["nassim_format"] = 3
        file.move("content/stress", "content/matrices")
        del file["content/shape"]
    image = path.read_bytes()[storage.SEAL_SIZE :]
    path.write_bytes(storage._seal(storage.hashlib.sha256(image)) + image)
    with pytest.warns(UserWarning, match="softens bodies too much where loads bend them: reduce the body again"):
        found = load(path)
    np.testing.assert_array_equal(found.stiffness(np.eye(4)[0]), matrices[0])
