#!/usr/bin/env bash
# Installs target/package/wcal_*.deb into a clean Debian 12 that mmdebstrap makes and throws away, and uses it as a person would.
# Exit codes: 0 good; 1 a check failed; 77 nothing was tested, since mmdebstrap is not there.
set -euo pipefail
cd "$(dirname "$0")/.."

fail() { echo "packaging/test.sh: FAILED: $*" >&2; exit 1; }
# check WHAT EXPECTED-STATUS COMMAND...: runs the command as a user without rights.
check() {
  local what=$1 expected=$2 found=0
  shift 2
  runuser -u nobody -- "$@" >/tmp/said 2>&1 || found=$?
  [ "$found" = "$expected" ] || fail "$what: expected exit code $expected, found $found: $(tail -5 /tmp/said)"
  echo "ok: $what"
}
said() { grep -qF -- "$1" /tmp/said || fail "expected '$1', found: $(tail -5 /tmp/said)"; }
no_wcal() {
  check "no wcal $1" 1 sh -c 'command -v wcal || command -v wcal-mujoco || exit 1'
  check "no manual page $1" 16 man -w wcal
}

# In the clean root.
inside() {
  cd /tmp
  local place=/tmp/user doc=/usr/share/doc/wcal deb archive began
  deb=$(echo /pkg/*.deb) archive=$(echo /pkg/*.tar.gz)
  install -d -o nobody "$place"
  echo "time: a clean Debian $(cat /etc/debian_version) in $(($(date +%s) - ${BEGAN:-0})) s"
  no_wcal "before the package (control)"
  began=$SECONDS; apt-get update -qq
  echo "time: apt-get update $((SECONDS - began)) s"
  began=$SECONDS
  DEBIAN_FRONTEND=noninteractive apt-get install -y --no-install-recommends "$deb" >/tmp/apt.log 2>&1 || fail "$(tail -20 /tmp/apt.log)"
  echo "time: apt-get install $((SECONDS - began)) s; $(grep -E '^Need to get|^After this' /tmp/apt.log | tr '\n' ' ')"
  check "the files are those of the package" 0 dpkg --verify wcal
  check "wcal --version" 0 wcal --version
  said "wcal $(dpkg-query -W -f '${Version}' wcal)"

  began=$SECONDS
  check "wcal demo" 0 wcal demo --out $place/demo
  echo "time: wcal demo $((SECONDS - began)) s"
  grep -q '<svg' $place/demo/pontius/report.html && [ -s $place/demo/report.html ] || fail "wcal demo left no page"

  # Every command has its page; a command that there is not has none.
  check "man -w wcal" 0 man -w wcal
  for name in $(wcal --help | sed -n '/^Commands:/,/^Options:/s/^  \([a-z][a-z-]*\) .*/\1/p' | grep -vx help); do
    check "man wcal-$name" 0 man --warnings -P cat "wcal-$name"
    said "wcal $name"
    if grep -q 'warning:' /tmp/said; then fail "wcal-$name.1: $(grep -m 3 warning: /tmp/said)"; fi
    grep -q -- "$name" /usr/share/zsh/vendor-completions/_wcal /usr/share/fish/vendor_completions.d/wcal.fish || fail "no completion of $name"
  done
  check "no page of no command (control)" 16 man -w wcal-tea
  check "bash completes ver" 0 bash -c '. /usr/share/bash-completion/completions/wcal && COMP_WORDS=(wcal ver) COMP_CWORD=1 && _wcal wcal ver wcal && echo "${COMPREPLY[@]}"'
  said verify

  # A whisker at one released pose, by MuJoCo; without MuJoCo's library there is no answer.
  cp -r $doc/examples $place/tour
  for table in points twin; do sed -i '/^point\|^9,/!d' $place/tour/fixtures/whiskerfbg/$table.csv; done
  chown -R nobody $place/tour
  cd $place/tour
  twin() { check "$1" "$2" wcal twin fixtures/whiskerfbg --engine mujoco --preset released --out "$place/$3.csv"; }
  twin "wcal twin by MuJoCo" 0 with
  grep -q '^9,.*,held,true' $place/with.csv || fail "expected a moment of pose 9, found: $(cat $place/with.csv)"
  mv /usr/lib/wcal/mujoco /tmp/mujoco
  twin "wcal twin without MuJoCo (control)" 1 without
  said 'libmujoco.so.3.17.0: cannot open'
  mv /tmp/mujoco /usr/lib/wcal/mujoco
  # The guide's own commands in a copy of the examples.
  check "the guide's plan" 0 wcal stage-sweep --plan rigs/plans/paper-27.toml --rig rigs/virtual --dry-run
  check "the guide's templates" 3 wcal verify examples/templates --check

  # Gone again, and the archive in another folder: Debian's libraries are still there.
  cd /tmp
  apt-get purge -y wcal >/tmp/apt.log 2>&1 || fail "$(tail -20 /tmp/apt.log)"
  no_wcal "after the purge (control)"
  tar -C $place -xf "$archive"
  check "the archive's wcal" 0 sh -c "$place/wcal-*/bin/wcal --version"
  check "the archive's engine" 0 sh -c "echo '{\"do\":\"hello\"}' | $place/wcal-*/bin/wcal-mujoco"
  said '3.17.0'
  echo "packaging/test.sh: passed"
}

if [ "${1:-}" = inside ]; then inside; exit 0; fi
if ! command -v mmdebstrap >/dev/null; then
  echo "packaging/test.sh: NOT TESTED: expected mmdebstrap (apt-get install mmdebstrap), found none" >&2
  exit 77
fi
[ -n "$(ls target/package/wcal_*_amd64.deb 2>/dev/null)" ] || fail "expected target/package/wcal_*_amd64.deb, found none: make package"
export LC_ALL=C.UTF-8 BEGAN
BEGAN=$(date +%s)
mmdebstrap --quiet --variant=apt --include=man-db --format=null \
  --customize-hook='mkdir -p "$1/pkg/packaging" && cp target/package/wcal*.deb target/package/wcal*.tar.gz "$1/pkg" && cp packaging/test.sh "$1/pkg/packaging"' \
  --customize-hook='chroot "$1" /pkg/packaging/test.sh inside' bookworm /dev/null || fail "see above"
echo "time: all of it $(($(date +%s) - BEGAN)) s"
