"""Calibrations on new readings."""

import json
import shutil
import sys

import numpy as np
import pytest

import wcal
from conftest import FIXTURES, draw


@pytest.fixture(scope="module")
def calibration(pontius):
    return wcal.verify(pontius, stimulus="load", response="deflection").calibration


def test_object_dict_and_path_predict_the_same(calibration, tmp_path):
    path = tmp_path / "calibration.json"
    calibration.save(path)
    table = {"load": [450000.0, 1500000.0]}
    by = [calibration, calibration.document, path, wcal.Calibration.load(path)]
    tables = [wcal.predict(one, table) for one in by] + [calibration.predict(table)]
    for one in tables:
        assert one.equals(tables[0])
    # NIST's certified quadratic.
    certified = np.poly1d([-0.316081871345029e-14, 0.732059160401003e-6, 0.673565789473684e-3])
    expected = certified(table["load"])
    name = next(c for c in tables[0].columns if c.startswith("response"))
    assert tables[0][name].tolist() == pytest.approx(expected, rel=1e-4)
    # Negative control: a number of the document is changed, and the seal says so.
    text = json.dumps(calibration.document)
    forged = json.loads(text.replace(calibration.document["session"], "other", 1))
    with pytest.raises(wcal.WcalError, match="sha256|sealed|changed"):
        wcal.predict(forged, table)


def test_the_load_follows_from_the_deflection(calibration):
    table = wcal.predict(calibration, {"deflection": [1.09146]})
    name = next(c for c in table.columns if c.startswith("stimulus"))
    assert table[name][0] == pytest.approx(1.5e6, rel=1e-3)
    # A missing value is not passed over: each row has its answer.
    with pytest.raises(wcal.WcalError, match="line 3"):
        wcal.predict(calibration, {"deflection": [1.0, None, 2.0]})
    # Negative control: a column that the calibration does not know.
    with pytest.raises(wcal.WcalError, match="data.csv"):
        wcal.predict(calibration, {"sugar": [1.0]})


def test_tables_are_dicts_of_lists_without_pandas(calibration, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    table = wcal.predict(calibration, {"load": [1.5e6, 2e6]})
    assert isinstance(table, dict) and table["stimulus"] == [1500000, 2000000]
    # Negative control.
    monkeypatch.undo()
    assert not isinstance(wcal.predict(calibration, {"load": [1.5e6]}), dict)


def test_readings_outside_the_range_are_marked_and_warned_of(calibration):
    with pytest.warns(wcal.WcalWarning, match="not to be trusted"):
        table = wcal.predict(calibration, {"load": [1500000.0, 9000000.0]})
    assert table["outside_valid_region"].tolist() == [0, 1]
    # Negative control: inside, without a warning.
    assert wcal.predict(calibration, {"load": [1500000.0]})["outside_valid_region"].tolist() == [0]


def test_what_is_made_of_simulated_readings_says_so(calibration):
    drawn = wcal.verify(draw(1e-6), stimulus="load", response="signal", simulated=True)
    assert wcal.predict(drawn.calibration, {"load": [50.0]})["simulated"].tolist() == [1]
    assert "simulated" in wcal.predict(calibration, {"load": [1.5e6]}, simulated=True).columns
    # Negative control: measured ones do not.
    assert "simulated" not in wcal.predict(calibration, {"load": [1.5e6]}).columns


def test_a_whisker_is_tracked_and_a_transducer_is_not(calibration, tmp_path):
    # A copy: that its holdout was opened is recorded in it.
    clamp = shutil.copytree(FIXTURES / "recorded/clamp", tmp_path / "clamp")
    whisker = wcal.verify(clamp).calibration
    rows = wcal.track(clamp, whisker)
    assert len(rows) > 10 and rows["simulated"].tolist() == [1] * len(rows)
    # Negative control.
    with pytest.raises(wcal.WcalError):
        wcal.track(clamp, calibration)
