from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any, NamedTuple

# A table: .columns and .to_numpy(), a dict of columns, rows with columns=[...], or a path.
_Table = Any
# A pandas DataFrame, or a dict of lists where pandas is not installed.
_Frame = Any
_Path = str | PathLike[str]

class WcalError(Exception): ...
class WcalWarning(UserWarning): ...

class Parameter(NamedTuple):
    value: float
    low: float
    high: float
    unit: str

@dataclass(frozen=True)
class Effect:
    id: str
    parameters: dict[str, Parameter]
    p_value: float
    sentence: str
    equivalent: tuple[str, ...]

class Calibration:
    document: dict[str, Any]
    def __init__(self, text: str) -> None: ...
    @classmethod
    def load(cls, path: _Path) -> Calibration: ...
    def save(self, path: _Path) -> None: ...
    def predict(self, readings: _Table, **options: Any) -> _Frame: ...

@dataclass(frozen=True)
class Result:
    verdict: str
    reason: str
    effects: list[Effect]
    before: dict[str, Any] | None
    after: dict[str, Any] | None
    calibration: Calibration | None
    report_html: str
    predictions: _Frame
    document: dict[str, Any]
    exit_code: int
    exit_meaning: str
    messages: tuple[str, ...]
    def _repr_html_(self) -> str: ...

def verify(
    data: _Table,
    kind: str = "transducer",
    *,
    stimulus: str | None = None,
    response: str | None = None,
    model: str = "linear",
    temperature: str | None = None,
    time: str | None = None,
    covariates: Iterable[str] | Mapping[str, str] = (),
    columns: Sequence[str] | None = None,
    holdout: _Table = None,
    accept: str | Iterable[str] = (),
    calibration: Calibration | Mapping[str, Any] | _Path | None = None,
    simulated: bool = False,
    name: str = "data",
    folder: _Path | None = None,
    seed: int = 1,
    **options: str | float | bool,
) -> Result: ...
def predict(
    calibration: Calibration | Mapping[str, Any] | _Path,
    readings: _Table,
    *,
    columns: Sequence[str] | None = None,
    simulated: bool = False,
) -> _Frame: ...
def track(
    data: _Table,
    calibration: Calibration | Mapping[str, Any] | _Path,
    *,
    motion: _Table = None,
    columns: Sequence[str] | None = None,
    tare_s: float | None = None,
    force: bool = False,
) -> _Frame: ...
