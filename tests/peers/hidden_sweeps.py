"""Hidden sweeps of the independent plant through the whole program (SIMULATED): 27 poses -> verdict -> calibration -> contacts beside the truth.

    cargo run --example hidden_sweeps -- 400 8 hidden
    python3 tests/peers/hidden_sweeps.py target/debug/wcal hidden/*

Printed for each sweep: verdict, whether the sweep refutes the declared model, which is the true one (it must not), error of the wire's axis at the contact
(mm, base frame), readings in contact whose arc length the stated region holds, readings without a place, and the statuses.
"""

import collections
import csv
import json
import math
import pathlib
import subprocess
import sys


def run(program, folder, *words):
    done = subprocess.run([program, *words], cwd=folder, capture_output=True, text=True)
    return done.returncode, done.stderr


def rows(path):
    with open(path, newline="") as file:
        return list(csv.DictReader(file))


def holds(regions, arclength_mm):
    pieces = [piece.split("@")[0].split("-") for piece in regions.split("|")]
    return any(float(a) - 1e-6 <= arclength_mm <= float(b) + 1e-6 for a, b in pieces)


def rms(errors):
    return math.sqrt(sum(e * e for e in errors) / len(errors))


def main():
    program, folders = str(pathlib.Path(sys.argv[1]).resolve()), map(pathlib.Path, sys.argv[2:])
    pooled, held, stated, refuted, flagged, contacts = [], 0, 0, 0, 0, 0
    for folder in folders:
        run(program, folder, "import", "readings.csv", "--kind", "sweep", "--motion", "base.csv", "--object", "object.stl",
            "--object-pose", "0,0,0,1,0,0,0", "--out", "sweep", "--force")
        run(program, folder, "verify", "session", "--sweep", "sweep", "--out", "verify", "--force")
        verdict = json.loads((folder / "verify/verify.json").read_text())
        declared = [e for e in verdict["tests"] if e["witness"] == "sweep" and not e["effects"]]
        refuted += declared[0]["refuted"]
        if not (folder / "verify/calibration.json").exists():
            print(f"{folder.name}: {verdict['verdict']}, no calibration")
            continue
        run(program, folder, "track", "sweep", "--calibration", "verify/calibration.json", "--out", "track.csv", "--force")
        errors, inside, regions, missing, status = [], 0, 0, 0, collections.Counter()
        for row, truth in zip(rows(folder / "track.csv"), rows(folder / "truth.csv")):
            if truth["contact"] != "1":
                continue
            status[row["status"]] += 1
            if not row["contact_x_mm"]:
                missing += 1
                continue
            errors.append(math.dist(*[[float(r[f"{name}_{c}_mm"]) for c in "xyz"] for r, name in ((row, "contact"), (truth, "axis"))]))
            if row["arclength_regions95"]:
                regions += 1
                inside += holds(row["arclength_regions95"], float(truth["arclength_mm"]))
        errors.sort()
        flagged += sum(n for name, n in status.items() if name != "ok")
        contacts += sum(status.values())
        if errors:
            print(f"{folder.name}: {verdict['verdict']}, declared model {'REFUTED' if declared[0]['refuted'] else 'stands'}; {len(errors)} contacts, median "
                  f"{errors[len(errors) // 2]:.2f}, rms {rms(errors):.2f}, regions hold {inside} of {regions}, without a place {missing}, {dict(status)}")
        pooled, held, stated = pooled + errors, held + inside, stated + regions
    pooled.sort()
    print(f"all: {len(pooled)} contacts, median {pooled[len(pooled) // 2]:.3f} mm, rms {rms(pooled):.3f}; regions hold {held} of {stated}; "
          f"{flagged} of {contacts} rows flagged; declared model refuted {refuted} times (SIMULATED)")


if __name__ == "__main__":
    main()
