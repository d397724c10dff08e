#!/usr/bin/env python3
"""The rest geometry of stereo-bench's wire (SIMULATED pictures): what `wcal fit-whisker` finds, against the specification and against the
wire that was drawn.

usage: tests/peers/whisker_bench.py WCAL BENCH SHAPES [--json FILE]

BENCH: folder with truth.json and rig.toml; SHAPES: shapes.json by `wcal stereo-shape`. The drawn wire comes from another rod on a mesh of its
own: its centre lines, without noise, are fitted by the same command. What is left between the two fits is the measurement's error.
"""
import argparse
import copy
import json
import math
import pathlib
import subprocess
import tempfile
import tomllib

KEYS = [("straight_mm", "straight", None), ("arc_radius_mm", "radius", 0.1), ("length_mm", "length", 0.2)]


def fit(wcal, shapes, rig, folder):
    done = subprocess.run([wcal, "fit-whisker", str(shapes), "--rig", str(rig), "--rest", "straight-arc", "--out", str(folder)], capture_output=True, text=True)
    assert done.returncode in (0, 3), done.stderr
    table = tomllib.loads((folder / "whisker.toml").read_text())
    return [table["whisker"][k] for k, _, _ in KEYS], table["fit"]["sd"][:3]


def drawn(measured, scene):
    """The measured shapes with the drawn lines in their place."""
    truth = {s["name"]: s for s in scene}
    made = copy.deepcopy(measured)
    for pair in made["pairs"]:
        true = truth[pair["name"]]
        line = true["centreline"]
        pair["centreline_mm"], pair["shared_errors"] = line, []
        pair["centreline_sd_mm"] = [pair["centreline_sd_mm"][0]] * len(line)
        pair["length_mm"] = sum(math.dist(a, b) for a, b in zip(line, line[1:]))
        if true["groove"]:
            pair["groove"]["position_mm"] = true["groove"]["position"]
            pair["groove"]["contact_arclength_mm"] = true["groove"]["contact_arclength"]
    return made


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("wcal")
    parser.add_argument("bench", type=pathlib.Path)
    parser.add_argument("shapes", type=pathlib.Path)
    parser.add_argument("--json", type=pathlib.Path)
    args = parser.parse_args()
    truth = json.loads((args.bench / "truth.json").read_text())
    with tempfile.TemporaryDirectory() as folder:
        folder = pathlib.Path(folder)
        lines = folder / "drawn.json"
        lines.write_text(json.dumps(drawn(json.loads(args.shapes.read_text()), truth["scene"])))
        found, sd = fit(args.wcal, args.shapes, args.bench / "rig.toml", folder / "measured")
        true, _ = fit(args.wcal, lines, args.bench / "rig.toml", folder / "drawn")
    print("SIMULATED pictures; mm")
    print(f"{'':<15}{'specified':>11}{'drawn':>11}{'found':>11}{'sd':>9}{'(found - specified)/sd':>24}{'(found - drawn)/sd':>20}")
    rows = []
    for k, (key, name, goal) in enumerate(KEYS):
        said, off = truth["spec"][name], found[k] - true[k]
        print(f"{key:<15}{said:>11.4f}{true[k]:>11.4f}{found[k]:>11.4f}{sd[k]:>9.4f}{(found[k] - said) / sd[k]:>24.2f}{off / sd[k]:>20.2f}")
        if goal:
            rows.append({"what": f"whisker {key} from stereo-bench", "peer": "specification", "ours": abs(found[k] - said), "theirs": goal, "unit": "mm",
                         "ratio": abs(found[k] - said) / goal, "goal": f"<= {goal} mm", "met": abs(found[k] - said) <= goal,
                         "note": f"{off / sd[k]:.1f} sd from the drawn wire"})
    if args.json:
        args.json.write_text(json.dumps({"rows": rows}, indent=1))


main()
