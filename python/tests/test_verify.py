"""The residual loop from Python: what it finds, and that it finds nothing where nothing is."""

import warnings

import numpy as np
import pytest

import wcal
from conftest import FIXTURES, draw

COLUMNS = {"stimulus": "load", "response": "signal"}


@pytest.fixture(scope="session")
def found(pontius):
    return wcal.verify(pontius, stimulus="load", response="deflection", name="cell")


def test_the_load_cell_of_nist_has_a_quadratic_term(found, pontius):
    assert (found.verdict, found.exit_code) == ("effect", 0), found
    assert [effect.id for effect in found.effects] == ["nonlinearity-quadratic"]
    assert found.exit_meaning == "adequate, or an effect was found and added"
    (fitted,) = found.effects[0].parameters.values()
    assert fitted.low < fitted.value < fitted.high
    before, after = (error["response_rmse"] for error in (found.before, found.after))
    assert before == pytest.approx(2.4e-3, rel=0.05) and after == pytest.approx(2.1e-4, rel=0.1)
    assert found.document["session"] == "cell" and found.reason == found.document["reason"]
    assert len(found.predictions) == 40 and "SIMULATED" not in repr(found)
    page = found._repr_html_()
    assert page.startswith("<iframe") and "&lt;html" in page and "<html" not in page
    # Negative control: with the term declared nothing is missing.
    declared = wcal.verify(pontius, stimulus="load", response="deflection", model="quadratic")
    assert (declared.verdict, declared.effects) == ("adequate", [])


def test_the_session_folder_gives_the_same_as_the_table(found):
    folder = wcal.verify(FIXTURES / "nist/pontius")
    assert folder.document["session"] == "pontius"
    for key in ("verdict", "effects", "before", "after", "detectable"):
        assert folder.document[key] == found.document[key], key
    # Negative control: other readings give another answer.
    assert wcal.verify(FIXTURES / "nist/loadcell").before != found.before


def test_every_kind_of_table_gives_the_same(pontius, found):
    rows = pontius.to_numpy()
    given = [
        ({name: column.tolist() for name, column in pontius.items()}, None),
        (rows, ["deflection", "load"]),
        (rows.tolist(), ["deflection", "load"]),
    ]
    for table, columns in given:
        same = wcal.verify(table, stimulus="load", response="deflection", columns=columns, name="cell")
        assert same.effects == found.effects and same.after == found.after
    file, names = FIXTURES / "nist/PONTIUS.DAT", ["deflection", "load"]
    options = {"skip_lines": 25, "whitespace": True, "columns": names, "name": "cell"}
    same = wcal.verify(file, stimulus="load", response="deflection", **options)
    assert same.effects == found.effects
    # Negative control: the names in the other order.
    other = wcal.verify(rows, stimulus="load", response="deflection", columns=["load", "deflection"])
    assert other.after != found.after


def test_a_drawn_load_cell_shows_what_was_drawn():
    bent = wcal.verify(draw(1e-6), **COLUMNS, simulated=True)
    assert bent.verdict == "effect" and "nonlinearity-quadratic" in bent.effects[0].equivalent
    assert bent.document["simulated"] and "(SIMULATED)" in repr(bent)
    assert "SIMULATED" in bent.report_html and "SIMULATED" in repr(bent.calibration)
    # Negative control: a straight one, which nobody marked.
    straight = wcal.verify(draw(0.0), **COLUMNS)
    assert (straight.verdict, straight.effects) == ("adequate", [])
    assert not straight.document["simulated"] and "SIMULATED" not in repr(straight)


def test_an_axis_is_verified_by_its_positions():
    commanded = np.tile(np.linspace(0.0, 100.0, 21), 3)
    noise = np.random.default_rng(2).normal(0.0, 1e-4, commanded.size)
    options = {"kind": "axis", "stimulus": "at", "response": "seen", "simulated": True}
    long = wcal.verify({"at": commanded, "seen": commanded * 1.0001 + noise}, **options)
    assert [effect.id for effect in long.effects] == ["scale"]
    value = next(iter(long.effects[0].parameters.values()))
    assert value.low < 100.0 < value.high or value.low < 1e-4 < value.high, value
    # Negative control: without the error of scale.
    assert wcal.verify({"at": commanded, "seen": commanded + noise}, **options).effects == []


def test_a_holdout_judges_and_a_folder_remembers_it(tmp_path):
    table, later = draw(1e-6), draw(1e-6, seed=7)
    options = {**COLUMNS, "simulated": True}

    def look(model, folder):
        result = wcal.verify(table, **options, model=model, holdout=later, folder=folder)
        judged = result.document["holdout"]
        assert judged["outcome"] == "confirmed", judged
        return judged["look"]

    # The same decision is one look, another one is the next, where the folder knows of the first.
    assert [look(model, tmp_path / "kept") for model in ("linear", "linear", "quadratic")] == [1, 1, 2]
    assert [look(model, None) for model in ("linear", "quadratic")] == [1, 1]
    # What made it stands in it: the command, not the program that this test runs in.
    kept = wcal.Calibration.load(tmp_path / "kept/verified/calibration.json")
    assert kept.document["provenance"]["command"][:2] == ["wcal", "verify"]
    # Negative control: a later state of another sensitivity contradicts.
    other = later.assign(signal=later["signal"] * 1.01)
    against = wcal.verify(table, **options, holdout=other)
    assert against.document["holdout"]["outcome"] == "contradicted" and against.exit_code == 4
    assert against.calibration is None and "sealed readings contradict" in against.exit_meaning


def test_what_is_odd_about_a_table_is_a_warning():
    table = draw(0.0)
    table.loc[3, "signal"] = None
    with pytest.warns(wcal.WcalWarning, match="no value of signal"):
        found = wcal.verify(table.assign(further=1.0), **COLUMNS)
    assert found.exit_code == 3 and found.exit_meaning
    assert any("columns not imported: further" in line for line in found.messages)
    # Negative control: nothing is odd.
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        wcal.verify(draw(0.0), **COLUMNS)
