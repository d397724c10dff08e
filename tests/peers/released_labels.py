"""The released calibration labels (fixtures/whiskerfbg/twin.csv) run again in python MuJoCo (SIMULATED), as the released program runs them.

usage: tests/peers/released_labels.py      (needs mujoco, of the version that is to be asked; the labels were made with 3.1; numpy)
Protocol and scene: calib/mujoco/groove_tip/SOURCE.md. Prints each pose's difference from its label and the fastest joint when it is read.
"""
import collections
import csv
import pathlib

import mujoco
import numpy as np

ROOT = pathlib.Path(__file__).resolve().parents[2]
PLUGINS = pathlib.Path(mujoco.__file__).parent / "plugin"
TOUCH = 'condim="6" friction="0.2 0.0001 0.0001" solref="0.002 1" solimp="0.15 0.4 0.004 0.9 6"'
START_MM = np.array([0, 7.855, 0])
FULL_SCALE_NMM = 7.0


def table(name):
    with open(ROOT / "fixtures/whiskerfbg" / name, encoding="utf8") as file:
        return list(csv.DictReader(file))


def model():
    vertices = " ".join(repr(float(x) * 1e-3) for row in table("rest_shape.csv") for x in row.values())
    tip = ROOT / "calib/mujoco/groove_tip"
    assets = "".join(f'<mesh name="tip{k}" file="{tip}/parts_{k}.stl"/>' for k in range(19))
    geoms = "".join(f'<geom type="mesh" mesh="tip{k}" contype="2" conaffinity="1" {TOUCH}/>' for k in range(19))
    slides = zip("xzy", ["1 0 0", "0 0 1", "0 1 0"])
    joints = "".join(f'<joint name="tip{n}" type="slide" axis="{axis}" damping="100"/>' for n, axis in slides)
    actuators = "".join(f'<position joint="tip{n}" kp="6000" kv="100"/>' for n in "xzy")
    return mujoco.MjModel.from_xml_string(f"""<mujoco><extension><plugin plugin="mujoco.elasticity.cable"/></extension>
<option timestep="0.001" gravity="0 0 0"/><size memory="10M"/><asset>{assets}</asset><worldbody>
<body name="base" pos="0 0 0.05"><composite prefix="w" type="cable" vertex="{vertices}" initial="none">
<plugin plugin="mujoco.elasticity.cable"><config key="twist" value="28e9"/><config key="bend" value="75e9"/></plugin>
<joint kind="main" damping="0.005" armature="0.00003"/>
<geom type="capsule" size="0.0001524" density="6450" contype="1" conaffinity="2" {TOUCH}/></composite></body>
<body name="tip" pos="0 0.065383 0.02585" quat="0.7071068 0.7071068 0 0">
<inertial pos="0 0 0" mass="0.03765868" diaginertia="1e-5 1e-5 1e-5"/>{joints}{geoms}</body></worldbody>
<actuator>{actuators}</actuator><sensor><torque name="torque" site="wS_first"/></sensor></mujoco>""")


def main():
    # Some versions load the cable's plugin with the package, and do not like it twice.
    if mujoco.__version__.startswith("3.17"):
        mujoco.mj_loadAllPluginLibraries(str(PLUGINS))
    m = model()
    d = mujoco.MjData(m)
    tip, site = m.body("tip").id, m.site("wS_first").id
    places = {int(r["point"]): [float(r[f"groove_{a}_mm"]) for a in "xyz"] for r in table("points.csv") if r["role"] == "calibration"}
    labels = {int(r["point"]): [float(r["moment_1_nmm"]), float(r["moment_2_nmm"])] for r in table("twin.csv")}
    recent = collections.deque(maxlen=10)

    def go(way, retreat=None):
        while True:
            mujoco.mj_step(m, d)
            if retreat is not None:
                d.ctrl[:] = retreat
                mujoco.mj_step(m, d, 10)
            d.ctrl[:] = way
            recent.append(d.xpos[tip].copy())
            if len(recent) == 10 and np.linalg.norm(recent[0] - recent[-1]) < 1e-6:
                break
        mujoco.mj_step(m, d, 4000)

    at_rest, last = [], np.zeros(3)
    for k, (point, place) in enumerate(sorted(places.items())):
        if k % 3 == 0:
            go(np.zeros(3), None if k == 0 else [0, -last[1] - 0.06, 0])
        last = (np.array(place) - START_MM) * 1e-3
        go([last[0], -last[1], last[2]])
        moment = d.site_xmat[site].reshape(3, 3) @ d.sensor("torque").data * 1e3
        off = np.abs(moment[[0, 2]] - labels[point]).max() / FULL_SCALE_NMM
        fastest = np.abs(d.qvel).max()
        at_rest.append((off, fastest < 1e-3))
        print(f"point {point:2}: off {off:.6f} of {FULL_SCALE_NMM:g} N mm, fastest joint {fastest:.1e} rad/s", flush=True)
    rest = [off for off, still in at_rest if still]
    moving = [off for off, still in at_rest if not still]
    print(f"MuJoCo {mujoco.__version__}: {len(rest)} poses at rest within {max(rest):.1e}; {len(moving)} others within {max(moving, default=0):.1e}")


main()
