#!/usr/bin/env python3
"""Stereo calibration of OpenCV's 13 real pairs (measured): wcal beside cv2. Same corners, then from the pictures alone.

usage: tests/peers/stereo.py WCAL SOLVE_CORNERS OUT.json
WCAL: a program with the command `stereo-calibrate`. SOLVE_CORNERS: the example `solve_corners` of wcal-vision (release build).
Installs opencv-python-headless and numpy into tests/peers/.venv where cv2 is missing. One thread.
"""
import json
import os
import pathlib
import subprocess
import sys
import tempfile
import time

HERE = pathlib.Path(__file__).resolve().parent
VENV = HERE / ".venv"


def with_peers():
    try:
        import cv2  # noqa: F401
        import numpy  # noqa: F401
    except ImportError:
        python = VENV / "bin" / "python"
        if pathlib.Path(sys.executable) == python:
            raise
        if not python.exists():
            subprocess.run([sys.executable, "-m", "venv", str(VENV)], check=True)
        subprocess.run([str(python), "-m", "pip", "-q", "install", "opencv-python-headless", "numpy"], check=True)
        os.execv(str(python), [str(python), *sys.argv])


def cv2_corners(cv2, np, pictures):
    """Corners of every pair by the classic finder and cornerSubPix with half window 5, as OpenCV's sample does with 11."""
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
    views = []
    for left in sorted(pictures.glob("left*.jpg")):
        pair = []
        for path in (left, left.with_name(left.name.replace("left", "right"))):
            image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
            found, corners = cv2.findChessboardCorners(image, (9, 6))
            assert found, path
            pair.append(cv2.cornerSubPix(image, corners, (5, 5), (-1, -1), until).reshape(-1, 2))
        views.append(pair)
    return views


def main():
    with_peers()
    import cv2
    import numpy as np

    cv2.setNumThreads(1)
    wcal, solver, out = sys.argv[1:4]
    pictures = HERE.parents[1] / "fixtures" / "opencv_stereo_chessboard"
    views = cv2_corners(cv2, np, pictures)
    board = np.array([[i, j, 0] for j in range(6) for i in range(9)], np.float32)
    objects = [board] * len(views)
    sides = [[v[k].reshape(-1, 1, 2) for v in views] for k in (0, 1)]
    until = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_COUNT, 200, 1e-10)
    seconds = []
    for _ in range(5):
        start = time.perf_counter()
        mono = [cv2.calibrateCamera(objects, s, (640, 480), None, None) for s in sides]
        rms, k1, d1, k2, d2, _, t, _, _ = cv2.stereoCalibrate(
            objects, *sides, mono[0][1], mono[0][2], mono[1][1], mono[1][2], (640, 480),
            flags=cv2.CALIB_USE_INTRINSIC_GUESS, criteria=until)
        seconds.append(time.perf_counter() - start)
    request = {"columns": 9, "rows": 6, "square": 1.0, "image_size": [640, 480], "repeat": 9,
               "views": [{"left": v[0].tolist(), "right": v[1].tolist()} for v in views]}
    environment = dict(os.environ, RAYON_NUM_THREADS="1")
    reply = subprocess.run([solver], input=json.dumps(request), capture_output=True, text=True, check=True, env=environment)
    ours = json.loads(reply.stdout)
    with tempfile.TemporaryDirectory() as folder:
        run = subprocess.run([wcal, "stereo-calibrate", str(pictures / "left*.jpg"), str(pictures / "right*.jpg"), "--board",
                              "9x6", "--square-mm", "1", "--out", folder], capture_output=True, text=True)
        assert run.returncode in (0, 3), run.stderr
        document = json.loads((pathlib.Path(folder) / "stereo.json").read_text())
    peer = f"cv2 {cv2.__version__}"
    baseline = float(np.linalg.norm(t))
    worst = max(v for pair in document["per_view_rms_px"] for v in pair)
    held = document["held_out"]

    def row(what, ours, theirs, unit, goal, met, note=""):
        ratio = ours / theirs if theirs else None
        return dict(what=what, peer=peer, ours=ours, theirs=theirs, unit=unit, ratio=ratio, goal=goal, met=bool(met), note=note)

    flat, warp, median = ours["flat"], ours["warp"], sorted(seconds)[2]
    rows = [
        row("same corners: RMS", flat["rms_px"], rms, "px", "equal to 1e-4", abs(flat["rms_px"] - rms) < 1e-4),
        row("same corners: baseline", flat["baseline"], baseline, "squares", "equal to 1e-4", abs(flat["baseline"] - baseline) < 1e-4),
        row("same corners: RMS with board warp", warp["rms_px"], 0.2076, "px", "<= 0.2076", warp["rms_px"] <= 0.2076 + 5e-5, "peer: mrcal, as stated"),
        row("same corners: time", ours["seconds"], median, "s", "<= 0.5", ours["seconds"] <= 0.5 * median,
            "both: each camera alone, then jointly; ours with outlier checks and warp"),
        row("from pictures: RMS", document["rms_px"], rms, "px", "<= 0.215, all 13 pairs", document["rms_px"] <= 0.215 and len(document["views"]) == 13),
        row("from pictures: worst view", worst, None, "px", "<= 0.32", worst <= 0.32),
        row("held-out epipolar mean", held["epipolar_mean_px"], None, "px", "< 0.135", held["epipolar_mean_px"] < 0.135),
        row("held-out epipolar p95", held["epipolar_p95_px"], None, "px", "< 0.355", held["epipolar_p95_px"] < 0.355),
    ]
    for r in rows:
        theirs = "-" if r["theirs"] is None else f"{r['theirs']:.4f}"
        print(f"{r['what']:36s} ours {r['ours']:.4f} {peer} {theirs} {r['unit']:8s} goal {r['goal']}: {'met' if r['met'] else 'not met'}")
    pathlib.Path(out).write_text(json.dumps({"rows": rows}, indent=1))


main()
