"""Calibrates transducers and axes: finds what the model of an instrument lacks.

``verify`` looks for the residual between readings and model, names the effect and adds it;
``predict`` applies the calibration to new readings; ``track`` says where a whisker touches.

A table is whatever has ``columns`` and ``to_numpy()`` (pandas, polars), a dict of columns, rows or an
array with ``columns=[...]``, or the path of a file. Missing values are None or NaN. Tables come back
as a pandas DataFrame, or as a dict of lists where pandas is not installed. In messages "line N" of a
table is its row N - 2, counted from 0: the header is line 1.
"""

from __future__ import annotations

import csv
import html
import json
import os
import tempfile
import warnings
from collections.abc import Mapping
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from . import _wcal

__all__ = ["Calibration", "Effect", "Parameter", "Result", "WcalError", "WcalWarning"]
__all__ += ["predict", "track", "verify"]


class WcalError(Exception):
    """What could not be done: what, where, what was expected and what was found."""


class WcalWarning(UserWarning):
    """The result is there, but something about it matters."""


class Parameter(NamedTuple):
    """A fitted parameter with its 95 % interval; the unit is "1" where it has none."""

    value: float
    low: float
    high: float
    unit: str


@dataclass(frozen=True)
class Effect:
    """An effect that the data ask for.

    ``equivalent`` are the effects that these data cannot distinguish from it, itself included; the
    p-value is adjusted for the whole catalogue.
    """

    id: str
    parameters: dict
    p_value: float
    sentence: str
    equivalent: tuple


class Calibration:
    """A sealed calibration, as ``calibration.json`` holds it."""

    def __init__(self, text):
        self._text = text
        try:
            self.document = json.loads(text)
        except ValueError as error:
            raise WcalError(f"calibration: expected JSON, found {error}") from None

    @classmethod
    def load(cls, path):
        """Reads calibration.json."""
        try:
            return cls(Path(path).read_text(encoding="utf-8"))
        except (OSError, UnicodeDecodeError) as error:
            raise WcalError(f"reading {path}: {error}") from None

    def save(self, path):
        """Writes calibration.json, which ``wcal predict`` and ``wcal track`` take, too."""
        Path(path).write_text(self._text, encoding="utf-8")

    def predict(self, readings, **options):
        """As ``wcal.predict``."""
        return predict(self, readings, **options)

    def __repr__(self):
        of = self.document
        said = {True: ", SIMULATED"}.get(of.get("provenance", {}).get("simulated"), "")
        return f"Calibration({of.get('verification')}{said}, expires {of.get('expires')})"


@dataclass(frozen=True, repr=False)
class Result:
    """What ``verify`` found.

    ``verdict``: adequate, effect, ambiguous, unknown-effect, twin-fault or refused. ``before`` and
    ``after``: held-out error of the declared and of the accepted model, or None. ``calibration`` is
    None where no model was accepted. ``predictions``: every reading with what both models say of it.
    ``document``: verify.json. ``messages``: what the program said beside. ``exit_code``, in words
    ``exit_meaning``: 0 adequate, or an effect was found and added; 1 refused; 3 as 0, but something
    about it matters; 4 the answer is "not good enough".
    """

    verdict: str
    reason: str
    effects: list
    before: dict | None
    after: dict | None
    calibration: Calibration | None
    report_html: str
    predictions: object
    document: dict
    exit_code: int
    exit_meaning: str
    messages: tuple

    def __repr__(self):
        mark = " (SIMULATED)" if self.document["simulated"] else ""
        return f"{self.document['session']}{mark}: {self.verdict}. {self.reason}"

    def _repr_html_(self):
        # A frame: the report's styles must not reach the notebook.
        page = html.escape(self.report_html, quote=True)
        style = 'style="width:100%;height:40em;border:1px solid #ccc"'
        return f'<iframe {style} srcdoc="{page}"></iframe>' if page else html.escape(repr(self))


def verify(
    data,
    kind="transducer",
    *,
    stimulus=None,
    response=None,
    model="linear",
    temperature=None,
    time=None,
    covariates=(),
    columns=None,
    holdout=None,
    accept=(),
    calibration=None,
    simulated=False,
    name="data",
    folder=None,
    seed=1,
    **options,
):
    """Finds what the declared model of an instrument lacks, and adds it.

    data: a table, or the folder of a session, which says itself what it holds.
    kind: "transducer" (stimulus, response) or "axis" (commanded and measured position, mm: stimulus
    and response here); "whisker" with model="WHISKER.toml".
    stimulus, response, temperature (deg C), time (s): names of columns; "COLUMN*FACTOR" multiplies.
    covariates: further columns, or a dict of names and columns. columns: names, where data has none.
    model: "constant", "linear" or "quadratic" (transducer).
    holdout: independent readings, not used in the fit: a table of the same columns, or a session.
    accept: an explanation to accept although others remain. calibration: one to be judged.
    simulated: the readings are not measured; all that is made of them says so. name: of the session.
    folder: where session and result stay. Without it they are temporary, and a second look at the
    same holdout is not known as one.
    options: further ones of ``wcal import``, as direction="dir", cycle="n", stimulus_unit="N".

    Raises WcalError where the data cannot be read; warns with WcalWarning of what is odd about them.
    """
    with _workplace(folder, simulated) as work:
        out, later, odd, imported = work / "verified", holdout, 0, []
        if _is_folder(data):
            session = data
        else:
            if Path(name).name != name:
                raise WcalError(f"name: expected a word for the session, found {name!r}")
            session, axis = work / name, kind == "axis"
            given = {
                "kind": kind,
                "out": session,
                "model": None if axis else model,
                "commanded" if axis else "stimulus": stimulus,
                "measured" if axis else "response": response,
                "temperature": temperature,
                "time": time,
                **options,
            }
            if isinstance(data, (str, os.PathLike)) and columns is not None:
                given["columns"] = ",".join(columns)
            if holdout is not None and not _is_folder(holdout):
                given["holdout"] = _table_file(holdout, work / "holdout.csv", columns)
                later = None
            own = covariates if isinstance(covariates, Mapping) else {c: c for c in covariates}
            further = [f"--covariate={named}={column}" for named, column in own.items()]
            table = _table_file(data, work / f"{name}.csv", columns)
            odd, imported = _run(["import", table, *further, *_options(given)], work)
        given = {"out": out, "seed": seed}
        given["accept"] = accept if isinstance(accept, str) else ",".join(accept)
        if later is not None:
            given["holdout"] = _table_file(later, work / "holdout.csv", columns)
        if calibration is not None:
            given["calibration"] = _calibration_file(calibration, work)
        code, said = _run(["verify", session, *_options(given)], work)
        if odd and not code:
            code = odd
            said.append(f"verify: exit code {odd}: the table was read with warnings; look at them")
        return _result(out, code, imported + said)


def _result(out, code, said):
    """The result in a folder of `wcal verify`."""
    read = {p.name: p.read_text(encoding="utf-8") for p in out.iterdir() if p.is_file()}
    found = json.loads(read["verify.json"])
    ends = f"verify: exit code {code}: "
    meaning = [line[len(ends) :] for line in said if line.startswith(ends)]
    effects = []
    for e in found["effects"]:
        fitted = e["parameters"]
        fitted = {p["name"]: Parameter(p["value"], *p["interval95"], p["unit"]) for p in fitted}
        effects.append(Effect(e["id"], fitted, e["p_value"], e["sentence"], tuple(e["class"])))
    sealed, table = read.get("calibration.json"), out / "predictions.csv"
    return Result(
        verdict=found["verdict"],
        reason=found["reason"],
        effects=effects,
        before=found["before"],
        after=found["after"],
        calibration=Calibration(sealed) if sealed else None,
        report_html=read.get("report.html", ""),
        predictions=_read_table(table) if table.exists() else None,
        document=found,
        exit_code=code,
        exit_meaning=meaning[0] if meaning else "adequate, or an effect was found and added",
        messages=tuple(line for line in said if not line.startswith(ends)),
    )


def predict(calibration, readings, *, columns=None, simulated=False):
    """Responses, stimuli, position errors or moments at new readings; point is the row, from 0.

    calibration: a Calibration, its document as a dict, or the path of calibration.json.
    readings: a table with the columns that the calibration was made from, or with the session's names
    (stimulus, response, commanded_mm, temperature_degc, ...). With the stimulus alone the response
    follows, with the response alone the stimulus.

    Rows outside the calibrated range are marked in outside_valid_region, and a WcalWarning says so.
    """
    with _workplace(simulated=simulated) as work:
        out = work / "predicted.csv"
        given = {"calibration": _calibration_file(calibration, work), "out": out}
        table = _table_file(readings, work / "data.csv", columns, numbered=True)
        _run(["predict", table, *_options(given)], work, doubts=True)
        return _read_table(out)


def track(data, calibration, *, motion=None, columns=None, tare_s=None, force=False):
    """Contact points of a whisker: one row a reading, by the motion that is known.

    data: the folder of a session, or a table of wavelengths with t_s. motion: log of the motion, as a
    table or a path. tare_s: duration at the start, free of contact, that gives the zero. force: track
    although the calibration is not to be trusted; every row says so then.
    """
    with _workplace() as work:
        out = work / "track.csv"
        given = {"calibration": _calibration_file(calibration, work), "out": out}
        given |= {"tare-s": tare_s, "force": force}
        if motion is not None:
            given["motion"] = _table_file(motion, work / "motion.csv", None)
        table = _table_file(data, work / "data.csv", columns)
        _, said = _run(["track", table, *_options(given)], work, doubts=True)
        if not out.exists():
            raise WcalError("; ".join(said))
        # The program says so in track.json.
        simulated = any("SIMULATED" in line for line in said)
        return _read_table(out, {"simulated": 1} if simulated else {})


@contextmanager
def _workplace(folder=None, simulated=False):
    """The folder that is given, or one for the moment."""
    # After Ctrl-C the computation may still write for a moment.
    moment = tempfile.TemporaryDirectory(prefix="wcal-", ignore_cleanup_errors=True)
    with moment if folder is None else nullcontext(folder) as place:
        place = Path(place).absolute()
        place.mkdir(parents=True, exist_ok=True)
        if simulated:
            (place / "SIMULATED").touch()
        yield place


def _is_folder(data):
    return isinstance(data, (str, os.PathLike)) and os.path.isdir(data)


def _options(given):
    """Options of the program; those without a value are left out."""
    words = {f"--{option.replace('_', '-')}": value for option, value in given.items()}
    flags = [word for word, value in words.items() if value is True]
    absent = {word for word, v in words.items() if v is None or v == "" or isinstance(v, bool)}
    return flags + [f"{word}={v}" for word, v in words.items() if word not in absent]


def _run(words, work, doubts=False):
    """Runs a command: exit code and the lines that it said, without the place of its files.

    doubts: where the code is not 0, whatever it said is a warning.
    """
    code, error, _, stderr = _wcal.run(["wcal", *map(str, words)])
    said = stderr.replace(f"{work}{os.sep}", "").splitlines()
    if error is not None:
        raise WcalError(error.replace(f"{work}{os.sep}", ""))
    for line in said:
        if line.startswith("warning: ") or (doubts and code != 0):
            warnings.warn(line.removeprefix("warning: "), WcalWarning, stacklevel=3)
    return code, said


def _calibration_file(calibration, work):
    """The path of a calibration."""
    if isinstance(calibration, (str, os.PathLike)):
        return os.fspath(calibration)
    of_dict = isinstance(calibration, Mapping)
    given = Calibration(json.dumps(calibration)) if of_dict else calibration
    if not isinstance(given, Calibration):
        found = type(calibration).__name__
        raise WcalError(f"calibration: expected a Calibration, a dict or a path, found {found}")
    path = work / "calibration.json"
    given.save(path)
    return path


def _table_file(data, path, columns, numbered=False):
    """The path of a table; what is none is written to `path`, its rows with their numbers."""
    if isinstance(data, (str, os.PathLike)):
        return os.fspath(data)
    if isinstance(data, Mapping):
        names, values = list(data), [list(column) for column in data.values()]
        lengths = {str(name): len(column) for name, column in zip(names, values)}
        if len(set(lengths.values())) > 1:
            raise WcalError(f"{path.name}: expected columns of one length, found {lengths}")
        rows = zip(*values)
    elif hasattr(data, "columns") and hasattr(data, "to_numpy"):
        names, rows = list(data.columns), data.to_numpy()
    elif columns is not None and hasattr(data, "__iter__"):
        names, rows = list(columns), data
    else:
        found = type(data).__name__
        wanted = "a DataFrame, a dict of columns, rows with columns=[...], or a path"
        raise WcalError(f"{path.name}: expected {wanted}, found {found}")
    numbered = numbered and "point" not in names
    with open(path, "w", newline="", encoding="utf-8") as file:
        table = csv.writer(file)
        table.writerow([str(name) for name in names] + ["point"] * numbered)
        for number, row in enumerate(rows):
            cells = [_cell(value) for value in row]
            if len(cells) != len(names):
                wanted = f"expected {len(names)} values, found {len(cells)}"
                raise WcalError(f"{path.name}, row {number}: {wanted}")
            table.writerow(cells + [number] * numbered)
    return path


def _cell(value):
    """A value as text that reads back as the same one; nothing for a missing one."""
    if value is None:
        return ""
    try:
        if value != value:
            return ""
    except TypeError:  # pandas.NA has no truth.
        return ""
    if type(value).__name__ in ("bool", "bool_"):
        return str(int(value))
    return value.isoformat() if hasattr(value, "isoformat") else str(value)


def _read_table(path, constants=()):
    """A table of the program: whole numbers, numbers or texts, by column."""
    with open(path, newline="", encoding="utf-8") as file:
        names, *rows = csv.reader(file)
    table = {name: _values([row[k] for row in rows]) for k, name in enumerate(names)}
    table |= {name: [constants[name]] * len(rows) for name in constants}
    try:
        import pandas
    except ImportError:
        return table
    return pandas.DataFrame(table)


def _values(cells):
    """Cells of a column in its narrowest type."""
    for kind, missing in ((int, None), (float, "nan")):
        try:
            return [kind(cell or missing) for cell in cells]
        except (TypeError, ValueError):
            continue
    return [cell or None for cell in cells]
