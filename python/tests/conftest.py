"""Data of the tests: a load cell of NIST (measured), and ones that are drawn (SIMULATED)."""

from pathlib import Path

import numpy as np
import pandas as pd
import pytest

ROOT = Path(__file__).resolve().parents[2]
FIXTURES = ROOT / "fixtures"


@pytest.fixture(scope="session")
def pontius():
    """The readings as NIST states them."""
    file = FIXTURES / "nist/PONTIUS.DAT"
    return pd.read_csv(file, skiprows=25, sep=r"\s+", names=["deflection", "load"])


def draw(quadratic, seed=1):
    """A load cell of 2 mV/V at 100 N, loaded three times (SIMULATED): noise of 1e-4 mV/V."""
    load = np.tile(np.linspace(0.0, 100.0, 11), 3)
    noise = np.random.default_rng(seed).normal(0.0, 1e-4, load.size)
    return pd.DataFrame({"load": load, "signal": 0.02 * load + quadratic * load**2 + noise})
