#!/usr/bin/env python3
"""Stereo calibration of OpenCV's 13 real pairs (measured): wcal beside cv2. Same corners, then from the pictures alone.

usage: tests/peers/stereo.py WCAL SOLVE_CORNERS OUT.json
WCAL: a program with the command `stereo-calibrate`. SOLVE_CORNERS: the example `solve_corners` of wcal-vision (release build).
Installs opencv-python-headless and numpy into tests/peers/.venv where cv2 is missing. One thread. mrcal (Debian's package of that
name) solves the same corners where it is installed.
"""
import json
import os
import pathlib
import shutil
import subprocess
import sys
import tempfile
import time

import peer_env

HERE = pathlib.Path(__file__).resolve().parent


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


MRCAL_RESULT = """
import mrcal, numpy, sys
models = [mrcal.cameramodel(f"{sys.argv[1]}/camera-{k}.cameramodel") for k in (0, 1)]
inputs = models[0].optimization_inputs()
x = mrcal.optimizer_callback(**inputs, no_jacobian=True, no_factorization=True)[1]
x = x[:mrcal.num_measurements_boards(**inputs)].reshape(-1, 2)
right_from_left = mrcal.compose_Rt(models[1].extrinsics_Rt_fromref(), models[0].extrinsics_Rt_toref())
print((x**2).sum(axis=1).mean()**0.5, numpy.linalg.norm(right_from_left[3]))
"""


def mrcal(views, pictures, skip_warp):
    """Per-point RMS (px), seconds and baseline of mrcal-calibrate-cameras on the same corners; None where it is not installed."""
    program = shutil.which("mrcal-calibrate-cameras")
    if program is None:
        return None
    names = sorted(p.name for p in pictures.glob("left*.jpg"))
    with tempfile.TemporaryDirectory() as folder:
        corners = pathlib.Path(folder) / "corners.vnl"
        lines = ["# filename x y"]
        for name, view in zip(names, views):
            for side, points in zip((name, name.replace("left", "right")), view):
                lines += [f"{pictures / side} {x:.9f} {y:.9f}" for x, y in points.tolist()]
        corners.write_text("\n".join(lines) + "\n")
        command = [program, "--corners-cache", str(corners), "--lensmodel", "LENSMODEL_OPENCV5", "--focal", "530", "--object-spacing", "1",
                   "--object-width-n", "9", "--object-height-n", "6", "--skip-outlier-rejection", "--outdir", folder]
        command += ["--skip-calobject-warp-solve"] if skip_warp else []
        start = time.perf_counter()
        run = subprocess.run([*command, str(pictures / "left*.jpg"), str(pictures / "right*.jpg")], capture_output=True, text=True)
        seconds = time.perf_counter() - start
        assert run.returncode == 0, run.stderr[-2000:]
        # The program prints one digit; the residuals are in what it wrote. Its library belongs to Debian's Python.
        reply = subprocess.run(["/usr/bin/python3", "-c", MRCAL_RESULT, folder], capture_output=True, text=True, check=True)
        rms, baseline = map(float, reply.stdout.split())
        return dict(rms=rms, seconds=seconds, baseline=baseline)


def main():
    peer_env.enter(["cv2", "numpy"], ["opencv-python-headless", "numpy"])
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
        return dict(what=what, peer="mrcal" if what.startswith("mrcal") else peer, ours=ours, theirs=theirs, unit=unit, ratio=ratio, goal=goal, met=bool(met), note=note)

    flat, warp, median = ours["flat"], ours["warp"], sorted(seconds)[2]
    mrcal_rows = []
    for skip_warp, own, name in ((True, flat, "flat board"), (False, warp, "board warp")):
        other = mrcal(views, pictures, skip_warp)
        if other is not None:
            note = "mrcal-calibrate-cameras on the same corners; its time includes starting Python and writing models"
            what = f"mrcal, {name}"
            mrcal_rows += [
                row(f"{what}: RMS", own["rms_px"], other["rms"], "px", "<= mrcal + 1e-4", own["rms_px"] <= other["rms"] + 1e-4, note),
                row(f"{what}: baseline", own["baseline"], other["baseline"], "squares", "equal to 0.1 %",
                    abs(own["baseline"] / other["baseline"] - 1) < 1e-3, note),
                row(f"{what}: time", ours["seconds"], other["seconds"], "s", "<= 1", ours["seconds"] <= other["seconds"], note),
            ]
    rows = [
        row("same corners: RMS", flat["rms_px"], rms, "px", "equal to 1e-4", abs(flat["rms_px"] - rms) < 1e-4),
        row("same corners: baseline", flat["baseline"], baseline, "squares", "equal to 1e-4", abs(flat["baseline"] - baseline) < 1e-4),
        row("same corners: RMS with board warp", warp["rms_px"], 0.2076, "px", "<= 0.2076", warp["rms_px"] <= 0.2076 + 5e-5, "peer: mrcal, as stated"),
        *mrcal_rows,
        row("same corners: time", ours["seconds"], median, "s", "<= 0.5", ours["seconds"] <= 0.5 * median,
            "both: each camera alone, then jointly; ours with outlier checks and warp"),
        row("from pictures: RMS", document["rms_px"], rms, "px", "<= 0.215, all 13 pairs", document["rms_px"] <= 0.215 and len(document["views"]) == 13),
        row("from pictures: worst view", worst, None, "px", "<= 0.32", worst <= 0.32),
        row("held-out epipolar mean", held["epipolar_mean_px"], None, "px", "< 0.135", held["epipolar_mean_px"] < 0.135),
        row("held-out epipolar p95", held["epipolar_p95_px"], None, "px", "< 0.355", held["epipolar_p95_px"] < 0.355),
    ]
    for r in rows:
        theirs = "-" if r["theirs"] is None else f"{r['theirs']:.4f}"
        print(f"{r['what']:36s} ours {r['ours']:.4f} {r['peer']} {theirs} {r['unit']:8s} goal {r['goal']}: {'met' if r['met'] else 'not met'}")
    pathlib.Path(out).write_text(json.dumps({"rows": rows}, indent=1))


main()
