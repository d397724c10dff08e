"""A known object as a judge of calibration and motion (SIMULATED): how often it refutes what is right, and what is wrong.

    cargo run --example hidden_sweeps -- 500 30 hidden
    python3 tests/peers/sweep_witness.py target/debug/wcal hidden/*

For each hidden sweep: the map of its 27 poses by the rod (`fit-gpr --labels rod`), then `track` with nothing changed, moments 20 % too large, the
motion's clock a second ahead, the map of the next sweep's whisker, and a calibration with a dead zone of 0.5 N mm that is not there. Printed for each:
how many the object refutes, with the Clopper-Pearson interval, and how many of them have the right suspect among those that explain it.
"""

import csv
import json
import math
import pathlib
import subprocess
import sys

POSE = "0,0,0,1,0,0,0"
FREE = 5
MAX_READINGS = 80
DEAD_ZONE_NMM = 0.5


def run(program, folder, *words):
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stderr


def read(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def write(path, rows):
    with open(path, "w", newline="") as file:
        table = csv.DictWriter(file, rows[0].keys())
        table.writeheader()
        table.writerows(rows)


def interval(k, n):
    """Clopper-Pearson, 95 %, by bisection on the binomial distribution."""
    def tail(p, low, high):
        return sum(math.comb(n, i) * p**i * (1 - p) ** (n - i) for i in range(low, high))

    def solve(rising):
        a, b = 0.0, 1.0
        for _ in range(60):
            p = 0.5 * (a + b)
            a, b = (p, b) if rising(p) else (a, p)
        return 0.5 * (a + b)

    low = 0.0 if k == 0 else solve(lambda p: tail(p, k, n + 1) < 0.025)
    high = 1.0 if k == n else solve(lambda p: tail(p, 0, k + 1) > 0.025)
    return low, high


def moments_changed(rows, law, change):
    """Readings whose moments, by the law of the map, are changed; the zero is the mean of the first free readings."""
    (a, b), (c, d) = law
    wavelengths = [[1e3 * float(r[f"fbg_{g}_nm"]) for g in (1, 2)] for r in rows]
    zero = [sum(w[g] for w in wavelengths[:FREE]) / FREE for g in (0, 1)]
    out = []
    for row, w in zip(rows, wavelengths):
        u, v = w[0] - zero[0], w[1] - zero[1]
        det = a * d - b * c
        m = change([(d * u - b * v) / det, (a * v - c * u) / det])
        shifts = [zero[0] + a * m[0] + b * m[1], zero[1] + c * m[0] + d * m[1]]
        out.append({**row, **{f"fbg_{g}_nm": f"{1e-3 * shifts[g - 1]:.7f}" for g in (1, 2)}})
    return out


def dead_zone(m):
    size = math.hypot(*m)
    # Noise of the free wire stays what it is.
    return [v * (1 + DEAD_ZONE_NMM / size) for v in m] if size > 0.03 else m


def judged(program, folder, name, readings, base, calibration):
    """Judgement of a variant of a sweep."""
    work = folder / "variants" / name
    work.mkdir(parents=True, exist_ok=True)
    write(work / "readings.csv", readings)
    write(work / "base.csv", base)
    run(program, work, "import", "readings.csv", "--kind", "sweep", "--motion", "base.csv", "--object", str(folder.resolve() / "object.stl"), "--object-pose",
        POSE, "--out", "sweep", "--force")
    code, said = run(program, work, "track", "sweep", "--calibration", str(calibration.resolve()), "--out", "track.csv", "--force")
    if code == 1:
        return {"refuted": True, "suspects": [], "cannot_judge": said.strip().splitlines()[-1]}
    return json.loads((work / "track.json").read_text())["object_judgement"]


def main():
    program, folders = str(pathlib.Path(sys.argv[1]).resolve()), [pathlib.Path(f) for f in sys.argv[2:]]
    calibrations = {}
    for folder in folders:
        run(program, folder, "fit-gpr", "session", "--labels", "rod", "--out", "map", "--force")
        if (folder / "map/calibration.json").exists():
            calibrations[folder] = folder / "map/calibration.json"
    names = {"nothing": None, "gain 1.2": "gain", "clock +1 s": "clock", "another whisker": None, "dead zone": None}
    refuted, told, unjudged = ({n: 0 for n in names} for _ in range(3))
    used = list(calibrations)
    for k, folder in enumerate(used):
        readings, base = read(folder / "readings.csv"), read(folder / "base.csv")
        # As a slower interrogator reads them.
        readings = readings[:: max(1, len(readings) // MAX_READINGS)]
        own, other = calibrations[folder], calibrations[used[(k + 1) % len(used)]]
        law = json.loads(own.read_text())["model"]["law"]["k_pm_per_nmm"]
        gain = lambda by: moments_changed(readings, law, lambda m: [by * v for v in m])
        clock = lambda by: [{**r, "t_s": f"{float(r['t_s']) + by:.6f}"} for r in base]
        variants = {"nothing": (readings, base, own), "gain 1.2": (gain(1.2), base, own), "clock +1 s": (readings, clock(1.0), own), "another whisker": (readings, base, other),
                    "dead zone": (moments_changed(readings, law, dead_zone), base, own)}
        for name, variant in variants.items():
            j = judged(program, folder, name.replace(" ", "_"), *variant)
            against = bool(j["refuted"]) or j["cannot_judge"] is not None
            refuted[name] += against
            unjudged[name] += j["cannot_judge"] is not None
            told[name] += any(s["id"] == names[name] and s["explains"] for s in j["suspects"])
            if (name == "nothing") == against:
                print(f"{folder.name} {name}: refuted {j['refuted']}, p {j.get('p_value')}, {j['cannot_judge']}, drift {j.get('zero_drift_nmm')}", flush=True)
    n = len(used)
    for name, suspect in names.items():
        low, high = interval(refuted[name], n)
        known = f", of them with the right suspect {told[name]}" if suspect else ""
        print(f"{name}: flagged {refuted[name]} of {n} [{low:.3f}, {high:.3f}] (of them could not be judged: {unjudged[name]}){known} (SIMULATED)")


if __name__ == "__main__":
    main()
