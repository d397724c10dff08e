#!/bin/sh
# Puts libmujoco 3.17.0 with its plugins and lib_coacd 1.0.14 from their PyPI wheels into native/ (not under version control).
# Does nothing where they are already; each library is compared with its SHA-256.
set -eu
cd "$(dirname "$0")/../../.."
wanted="$(cat <<'SUMS'
23496b023ee80fb61ab71167e94bc649f9941710fde96b18bb8204fb332523ad  native/mujoco/libmujoco.so.3.17.0
0c02155f9159a6f0082ee98695e489cef2d9657f9ba8edb1e1a343e69b2af3cc  native/mujoco/plugin/libelasticity.so
4c7134a59d9e96278d291703042063ecb52dd4c00a3574a5ee2c6de45fb0b487  native/coacd/coacd/lib_coacd.so
SUMS
)"
whole() { printf '%s\n' "$wanted" | sha256sum --check --status 2>/dev/null; }
whole && exit 0
if [ "$(uname -s -m)" != "Linux x86_64" ]; then
  echo "fetch.sh: expected Linux x86_64, found $(uname -s -m): built without MuJoCo" >&2
  exit 0
fi
rm -rf native
mkdir -p native/wheels native/mujoco
python3 -m pip download --quiet --disable-pip-version-check --no-deps --only-binary=:all: --python-version 3.11 --implementation cp \
  --platform manylinux_2_28_x86_64 --platform manylinux_2_27_x86_64 --platform manylinux2014_x86_64 \
  --dest native/wheels mujoco==3.17.0 coacd==1.0.14
python3 - <<'PY'
import glob, zipfile
for wheel, keep in (("mujoco", ("mujoco/libmujoco", "mujoco/plugin/")), ("coacd", ("coacd/lib_", "coacd.libs/"))):
    [path] = glob.glob(f"native/wheels/{wheel}-*.whl")
    with zipfile.ZipFile(path) as z:
        z.extractall("native" if wheel == "mujoco" else "native/coacd", [n for n in z.namelist() if n.startswith(keep) or "LICENSE" in n])
PY
rm -r native/wheels
whole || { echo "fetch.sh: a library differs from its SHA-256" >&2; printf '%s\n' "$wanted" | sha256sum --check >&2; exit 1; }
