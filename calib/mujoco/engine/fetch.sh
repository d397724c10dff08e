#!/bin/sh
# Puts libmujoco 3.17.0 with its plugins and lib_coacd 1.0.14 from their PyPI wheels into native/ (not under version control).
# Does nothing where they are already. Every library has its SHA-256 here: native/ holds these and no other, or is not there.
set -eu
cd "$(dirname "$0")/../../.."
wanted="$(cat <<'SUMS'
23496b023ee80fb61ab71167e94bc649f9941710fde96b18bb8204fb332523ad  native/mujoco/libmujoco.so.3.17.0
5c0f0fcd0443a1927444230a495c51c8dac05226e331431ea88151f105e561cb  native/mujoco/plugin/libactuator.so
0c02155f9159a6f0082ee98695e489cef2d9657f9ba8edb1e1a343e69b2af3cc  native/mujoco/plugin/libelasticity.so
aefae00d4024da61d063287a4985d7ef09de68895c7cbaa756c9b03a3d90efc8  native/mujoco/plugin/libsdf_plugin.so
b072a7945e0ac5b1471d115dc1ba2073f68749b423bea60d9f3c199c60d219d7  native/mujoco/plugin/libsensor.so
4c7134a59d9e96278d291703042063ecb52dd4c00a3574a5ee2c6de45fb0b487  native/coacd/coacd/lib_coacd.so
3a7eaece7231911be2fbb1b3e7cb4cb5c2e0f84e0c2bb73739472b5a1feec8c1  native/coacd/coacd.libs/libgomp-a34b3233.so.1.0.0
SUMS
)"
# What is listed is as listed, and nothing else that could be loaded lies beside it.
whole() {
  printf '%s\n' "$wanted" | sha256sum --check --status 2>/dev/null &&
    [ "$(find native -name '*.so*' | sort)" = "$(printf '%s\n' "$wanted" | sed 's/^[^ ]*  //' | sort)" ]
}
whole && exit 0
if [ "$(uname -s -m)" != "Linux x86_64" ]; then
  echo "fetch.sh: expected Linux x86_64, found $(uname -s -m): built without MuJoCo" >&2
  exit 0
fi
# Whatever goes wrong from here on, no library stays that was not compared.
trap 'rm -rf native' EXIT
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
if ! whole; then
  echo "fetch.sh: expected the libraries of fetch.sh by their SHA-256, found others; native/ is removed:" >&2
  printf '%s\n' "$wanted" | sha256sum --check >&2 || true
  find native -name '*.so*' | sort >&2
  exit 1
fi
trap - EXIT
