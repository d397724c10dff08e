"""The MJCF that wcal writes, in MuJoCo itself: under the rod's contact force the wire must lie where the rod lies.

usage: mujoco_statics.py WRITE_MJCF [--json FILE]   (needs mujoco==3.17.0; WRITE_MJCF is calib/mujoco's example)
Prints error of the loaded point over its deflection and of the base moment, for 20, 40 and 80 links, with the plain clamp (spring of a
whole link) as negative control.
"""
import argparse, json, os, re, subprocess, tempfile
import mujoco
import numpy as np

a = argparse.ArgumentParser()
a.add_argument("write_mjcf")
a.add_argument("--json")
a = a.parse_args()


def settle(xml, links, rod):
    model = mujoco.MjModel.from_xml_string(xml)
    # Statics only: heavy joints and strong damping change no equilibrium and let the step be long.
    model.dof_armature[:] = 1e-6
    model.dof_damping[:] = model.jnt_stiffness * 0.5
    model.opt.timestep = 5e-3
    data = mujoco.MjData(model)
    h = rod["length_mm"] / links
    link = min(int(rod["arclength_mm"] / h), links - 1)
    body = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, f"link{link}")
    along = np.array([(rod["arclength_mm"] - link * h) * 1e-3, 0, 0])
    force = np.array(rod["force_n"])
    for k in range(20000):
        point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ along
        data.qfrc_applied[:] = 0
        mujoco.mj_applyFT(model, data, force * min(1, k / 2000), np.zeros(3), point, body, data.qfrc_applied)
        mujoco.mj_step(model, data)
    speed = np.abs(data.qvel).max()
    point = data.xpos[body] + data.xmat[body].reshape(3, 3) @ along
    return point * 1e3, speed


rows = []
for links in (20, 40, 80):
    with tempfile.TemporaryDirectory() as d:
        out = os.path.join(d, "whisker.xml")
        rod = json.loads(subprocess.run([a.write_mjcf, str(links), out], check=True, capture_output=True, text=True).stdout)
        xml = open(out).read()
    first = re.compile(r'(name="joint0[xyz]"[^>]*stiffness=")([^"]+)"')
    plain = first.sub(lambda m: f'{m[1]}{float(m[2]) / 2!r}"', xml)
    deflection = np.linalg.norm(np.subtract(rod["point_mm"], rod["rest_mm"]))
    row = {"links": links, "deflection_mm": deflection}
    for name, text in (("wcal", xml), ("plain", plain)):
        point, speed = settle(text, links, rod)
        moment = np.cross(point, rod["force_n"])
        row[name] = {
            "point_error": float(np.linalg.norm(point - rod["point_mm"]) / deflection),
            "moment_error": float(np.linalg.norm(moment - rod["moment_nmm"]) / np.linalg.norm(rod["moment_nmm"])),
            "speed_rad_s": float(speed),
        }
    rows.append(row)
    print(f"{links:3d} links: point off by {row['wcal']['point_error']:.4%} of {deflection:.2f} mm, base moment {row['wcal']['moment_error']:.4%}; "
          f"spring of a whole link at the clamp: {row['plain']['point_error']:.4%}, {row['plain']['moment_error']:.4%}")
order = np.log2(rows[0]["wcal"]["point_error"] / rows[2]["wcal"]["point_error"]) / 2
print(f"order {order:.2f}; MuJoCo {mujoco.__version__}")
if a.json:
    json.dump({"mujoco": mujoco.__version__, "order": order, "rows": rows}, open(a.json, "w"), indent=1)
