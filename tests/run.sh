#!/usr/bin/env bash
# Every test. What keeps time (a bench, a stream) leaves the machine mostly idle and must not wait for it; all else runs beside it with the lowest
# priority, in two halves, since a target ends with one long test that leaves a core idle. Nothing stops at the first failure; failures are said last.
set -uo pipefail
cd "$(dirname "$0")/.."
tests="cargo test --workspace --locked --no-fail-fast"
# Targets that take about half of the time.
half="accuracy commands track"
# All others, as cargo knows them: none is left out.
rest=$(cargo metadata --no-deps --locked --format-version 1 | python3 -c '
import json, sys
names = {t["name"] for p in json.load(sys.stdin)["packages"] for t in p["targets"] if "test" in t["kind"]}
print(*sorted(names - set(sys.argv[1:])))' $half) || exit 1

# Runs a part under its name, its output in target/test-NAME.log.
part() {
  local name=$1 began=$SECONDS
  shift
  if "$@" >"target/test-$name.log" 2>&1; then echo "tests, $name: passed in $((SECONDS - began)) s"; else
    echo "tests, $name: FAILED after $((SECONDS - began)) s, see target/test-$name.log"
    return 1
  fi
}

one_half() { nice -n 19 $tests $(printf -- '--test %s ' $half) -- --skip keeps_time::; }
other_half() {
  local failed=0
  nice -n 19 $tests --lib --bins $(printf -- '--test %s ' $rest) -- --skip keeps_time:: || failed=1
  nice -n 19 $tests --doc || failed=1
  return $failed
}

part half one_half & one=$!
part rest other_half & other=$!
# Sweeps and streams are judged by their devices' time, not by the speed of a disk that builds and other tests keep busy for seconds.
memory=/dev/shm
if [ "$(df --output=avail -m $memory 2>/dev/null | tail -1)" -ge 2000 ] 2>/dev/null; then export TMPDIR=$memory; else
  echo "tests: no 2 GB free in $memory: what keeps time records on the disk, and may fail where that is busy"
fi
part timed $tests --test live --test drivers --test contracts -- keeps_time::
failed=$?
wait $one || failed=1
wait $other || failed=1
cat target/test-{half,rest,timed}.log | grep -E '^     Running|^test result'
if [ $failed != 0 ]; then
  grep -h -E -A 12 '^error|^---- .* stdout|^thread .* panicked|^test .* FAILED$' target/test-{half,rest,timed}.log
fi
exit $failed
