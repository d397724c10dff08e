#!/usr/bin/env python3
"""Map peers: the same candidates by scikit-learn on fixtures/whiskerfbg, timed beside wcal-gpr.

Installs numpy, scipy and scikit-learn in tests/peers/.venv on the first run. Prints a table, and writes JSON rows for
peers.json to the file named by --out (stdout without it). Single thread on both sides. wcal's numbers come from its
criterion benches (cargo bench --workspace) and from fit-gpr.json where --fit-gpr names one.
"""

import argparse
import json
import os
import pathlib
import subprocess
import time

import peer_env

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parent.parent
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[name] = "1"


def load():
    """Shifts (pm), moments (N mm) and trajectory (0 at rest) of the measured set."""
    import numpy as np

    folder = ROOT / "fixtures" / "whiskerfbg"
    points = np.genfromtxt(folder / "points.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    twin = np.genfromtxt(folder / "twin.csv", delimiter=",", names=True)
    shifts = 1e3 * np.c_[points["fbg_1_shift_nm"], points["fbg_2_shift_nm"]]
    moments = np.c_[twin["moment_1_nmm"], twin["moment_2_nmm"]]
    return shifts, moments, np.where(points["role"] == "rest", 0, points["trajectory"])


def thin_plate_class():
    """The thin-plate kernel for scikit-learn (R fixed), scaled to 1 at distance 0."""
    import numpy as np
    from sklearn.gaussian_process.kernels import Kernel, NormalizedKernelMixin, StationaryKernelMixin

    class ThinPlate(StationaryKernelMixin, NormalizedKernelMixin, Kernel):
        def __init__(self, radius=1.0):
            self.radius = radius

        def __call__(self, X, Y=None, eval_gradient=False):
            Y = X if Y is None else Y
            u = np.linalg.norm(X[:, None] - Y[None], axis=-1) / self.radius
            k = 1 + u * u * (2 * u - 3)
            return (k, np.empty((*k.shape, 0))) if eval_gradient else k

    return ThinPlate


def candidates(diameter):
    """Constructors of scikit-learn's maps by wcal's candidate names; inputs are scaled."""
    from sklearn.gaussian_process import GaussianProcessRegressor as Gp
    from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel
    from sklearn.linear_model import LinearRegression
    from sklearn.pipeline import make_pipeline
    from sklearn.preprocessing import PolynomialFeatures

    scale = lambda: ConstantKernel(1.0, (1e-3, 1e9))
    noise = lambda: WhiteKernel(0.1, (1e-9, 1e2))
    thin_plate = thin_plate_class()
    return {
        "affine": LinearRegression,
        "quadratic": lambda: make_pipeline(PolynomialFeatures(2), LinearRegression()),
        "thin-plate-constant": lambda: Gp(
            scale() * thin_plate(1.6 * 1.2 * diameter) + noise(), normalize_y=True, n_restarts_optimizer=2, random_state=0
        ),
        "matern52": lambda: Gp(
            scale() * Matern(diameter, (0.1 * diameter, 20 * diameter), nu=2.5) + noise(),
            normalize_y=True,
            n_restarts_optimizer=2,
            random_state=0,
        ),
    }


def left_out(make, x, y, folds):
    """Root mean square left-out error; everything is refitted in each fold."""
    import numpy as np

    errors = []
    for held in folds:
        kept = ~held
        errors.extend(make().fit(x[kept], y[kept]).predict(x[held]) - y[held])
    return float(np.sqrt(np.mean(np.square(errors))))


def released(shifts, moments):
    """Leave-one-out of the released code's map in its own scale: unscaled kernel, R = 1000, noise 3^2 + 1."""
    import numpy as np

    x, y = (shifts / 1e3 + 0.37) / 0.49, (moments + 4) / 7
    r = np.linalg.norm(x[:, None] - x[None], axis=-1)
    inverse = np.linalg.inv((2 * r**3 - 3e3 * r**2 + 1e9) / 12 + 10 * np.eye(len(x)))
    return np.sqrt(np.mean((inverse @ y / np.diag(inverse)[:, None]) ** 2, axis=0))


def run_peer():
    """scikit-learn's errors, its time to fit and choose, and its time for one prediction with deviation."""
    import warnings

    import numpy as np

    warnings.filterwarnings("ignore")
    shifts, moments, trajectory = load()
    x = (shifts - shifts.mean(0)) / shifts.std()
    diameter = max(np.linalg.norm(a - b) for a in x for b in x)
    loo = [np.arange(len(x)) == i for i in range(len(x))]
    loto = [trajectory == t for t in sorted(set(trajectory) - {0})]
    rows, fits = {}, {}
    total = 0.0
    for name, make in candidates(diameter).items():
        start = time.perf_counter()
        fits[name] = [make().fit(x, moments[:, m]) for m in (0, 1)]
        by_trajectory = [left_out(make, x, moments[:, m], loto) for m in (0, 1)]
        total += time.perf_counter() - start
        rows[name] = {"loo": [left_out(make, x, moments[:, m], loo) for m in (0, 1)], "loto": by_trajectory}
    each = []
    for i in range(400):
        start = time.perf_counter()
        for gp in fits["matern52"]:
            gp.predict(x[i % len(x)][None], return_std=True)
        each.append(time.perf_counter() - start)
    return rows, 1e3 * total, 1e6 * float(np.median(each)), released(shifts, moments) * 7


def run_ours():
    """wcal-gpr's criterion benches: lines of JSON among their output."""
    out = []
    for bench in ("fit", "stream"):
        command = ["cargo", "bench", "--workspace", "--bench", bench]
        done = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True)
        out += [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]
    fits = {r["candidates"]: r["median_ms"] for r in out if r["bench"] == "fit"}
    return fits, {r["map"]: r for r in out if r["bench"] == "stream"}


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--fit-gpr", type=pathlib.Path, help="fit-gpr.json of fixtures/whiskerfbg with --labels twin")
    parser.add_argument("--out", type=pathlib.Path, help="file for the JSON rows")
    args = parser.parse_args()
    peer_env.enter(["numpy", "scipy", "sklearn"], ["numpy", "scipy", "scikit-learn"])
    import sklearn

    peer = f"scikit-learn {sklearn.__version__}"
    theirs, their_ms, their_us, as_released = run_peer()
    our_fits, streams = run_ours()
    rows = []
    add = lambda **row: rows.append({"note": "", **row})
    for count, our_ms in sorted(our_fits.items()):
        add(what=f"map: fit and choose {count} maps (loto refits) on whiskerfbg", peer=peer, ours=our_ms, theirs=their_ms, unit="ms",
            ratio=our_ms / their_ms, goal="ratio <= 0.01", met=our_ms / their_ms <= 0.01,
            note="wcal with intervals; the peer fits four")
    m52 = streams["matern52"]
    add(what="map: one reading, both moments with deviations", peer=peer, ours=m52["p50_us"], theirs=their_us, unit="us",
        ratio=m52["p50_us"] / their_us, goal="below peer", met=m52["p50_us"] < their_us)
    for name, row in streams.items():
        add(what=f"map at stream rate, 16 whiskers, p99, {name}", peer="limit", ours=row["p99_us"], theirs=100.0, unit="us",
            ratio=row["p99_us"] / 100, goal="p99 < 100 us and >= 32000 readings/s",
            met=row["p99_us"] < 100 and row["readings_per_s"] >= 32_000)
    if args.fit_gpr:
        document = json.loads(args.fit_gpr.read_text())
        ours = next(c for c in document["candidates"] if c["name"] == document["chosen"])
        for m in (0, 1):
            for split in ("loo", "loto"):
                best_name, best = min(((n, t[split][m]) for n, t in theirs.items()), key=lambda pair: pair[1])
                value = ours[f"{split}_rmse_nmm"][m]
                add(what=f"map: {split} of moment {m + 1}, {ours['name']}", peer=f"{peer} {best_name}", ours=value,
                    theirs=best, unit="N mm", ratio=value / best, goal="ratio <= 1.02", met=value / best <= 1.02)
    print(f"{'map (scikit-learn)':<24}{'loo 1':>9}{'loo 2':>9}{'loto 1':>9}{'loto 2':>9}   N mm")
    for name, row in theirs.items():
        print(f"{name:<24}" + "".join(f"{v:9.4f}" for v in [*row["loo"], *row["loto"]]))
    print(f"{'as released':<24}{as_released[0]:9.4f}{as_released[1]:9.4f}")
    print(f"\n{'what':<58}{'wcal':>11}{'peer':>11}  unit  ratio")
    for row in rows:
        print(f"{row['what']:<58}{row['ours']:11.4g}{row['theirs']:11.4g}  {row['unit']:<5} {row['ratio']:.4g}")
    text = json.dumps({"rows": rows}, indent=1)
    if args.out:
        args.out.write_text(text + "\n")
    else:
        print(text)


if __name__ == "__main__":
    main()
