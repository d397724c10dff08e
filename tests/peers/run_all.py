#!/usr/bin/env python3
"""`make peers`: every comparison in turn. One that fails does not stop the others: it is noted in its peers-*.json and in the exit status.

usage: tests/peers/run_all.py [--ycb FOLDER] [NAME ...]     without names: all; FOLDER of STL files: also the paper's whole sweep set

Runs in the repository's root. Each comparison is a list of commands; the first that fails ends it.
"""
import argparse
import json
import pathlib
import subprocess
import sys

HERE = pathlib.Path(__file__).resolve().parent
ROOT = HERE.parents[1]
PYTHON, RELEASED = (str(HERE / venv / "bin/python") for venv in (".venv", ".venv-released"))
RELEASE = "target/release"


def script(name, *arguments, python=PYTHON):
    return [python, str(HERE / name), *arguments]


# One selection of packages for every row: another would unify features otherwise and compile all third-party code anew.
BUILD = ["cargo", "build", "--release", "--locked", "--workspace", "--bins", "--examples"]


def comparisons(ycb):
    """Name and commands; the rows of NAME go to peers-NAME.json."""
    wcal = f"{RELEASE}/wcal"
    example = lambda name: f"{RELEASE}/examples/{name}"
    yield "rod", [
        BUILD,
        script("rod_peers.py", "--binary", example("peer_poses"), "--json", "peers-rod.json"),
    ]
    yield "map", [script("map_peers.py", "--out", "peers-map.json")]
    yield "mujoco", [
        BUILD,
        script("mujoco_statics.py", example("write_mjcf"), "--json", "peers-mujoco.json"),
    ]
    yield "released-labels", [
        [sys.executable, "-m", "venv", str(HERE / ".venv-released")],
        [RELEASED, "-m", "pip", "install", "-q", "numpy", "mujoco==3.1.6"],
        script("released_labels.py", python=RELEASED),
        script("released_labels.py"),
    ]
    yield "mujoco-rate", [
        BUILD,
        script("mujoco_rate.py", example("write_world"), f"{RELEASE}/wcal-mujoco", "--json", "peers-mujoco-rate.json"),
        [example("compare_engines"), "target/convex", "4"],
    ]
    yield "stereo", [
        BUILD,
        script("stereo.py", wcal, example("solve_corners"), "peers-stereo.json"),
    ]
    yield "stereo-bench", [BUILD, script("stereo_bench.py", wcal)]
    yield "network", [
        BUILD,
        script("network_peers.py", example("network_time"), "--json", "peers-network.json", python=sys.executable),
    ]
    if ycb:
        yield "sweeps", [
            BUILD,
            script("ycb_sweeps.py", f"{RELEASE}/wcal-lab", ycb, "--json", "peers-sweeps.json"),
        ]
    yield "vendor-client", [
        ["cargo", "test", "--release", "--locked", "--workspace", "--test", "drivers", "vendor_client::", "--", "--ignored", "--nocapture"],
    ]


def run(command):
    """None, or why it failed; what it says goes on to the terminal."""
    print("+", " ".join(command), flush=True)
    try:
        child = subprocess.Popen(command, cwd=ROOT, stderr=subprocess.PIPE, text=True, errors="replace")
    except OSError as error:
        return f"{command[0]}: {error}"
    last = ""
    for line in child.stderr:
        sys.stderr.write(line)
        last = line.strip() or last
    code = child.wait()
    return None if code == 0 else f"{' '.join(command)}: exit status {code}: {last}"


def note_failure(path, name, why):
    """Adds a row that says so to what the comparison itself wrote."""
    try:
        rows = json.loads(path.read_text())["rows"]
    except (OSError, ValueError, KeyError, TypeError):
        rows = []
    rows.append({"what": f"comparison {name}", "met": False, "note": f"failed: {why}"})
    path.write_text(json.dumps({"rows": rows}, indent=1) + "\n")


def main():
    arguments = argparse.ArgumentParser(description="every comparison with a peer in turn")
    arguments.add_argument("--ycb", help="folder of STL files: also the paper's whole sweep set")
    arguments.add_argument("--list", action="store_true", help="print the commands as JSON and run nothing")
    arguments.add_argument("names", nargs="*", metavar="NAME")
    options = arguments.parse_args()
    known = dict(comparisons(options.ycb))
    if options.list:
        print(json.dumps(known))
        return 0
    unknown = [name for name in options.names if name not in known]
    if unknown:
        arguments.error(f"expected names among {', '.join(known)}, found {', '.join(unknown)}")
    failed = {}
    for name in options.names or known:
        print(f"\n== {name}", flush=True)
        path = ROOT / f"peers-{name}.json"
        # Rows of an earlier run are not those of this one.
        path.unlink(missing_ok=True)
        why = next(filter(None, map(run, known[name])), None)
        if why is not None:
            note_failure(path, name, why)
            failed[name] = why
    for name, why in failed.items():
        print(f"peers: {name} failed: {why}", file=sys.stderr)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main())
