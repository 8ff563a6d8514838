#!/usr/bin/env bash
# Makes a stage driver and an accelerometer driver with scripts/new-driver in a copy of the sources, builds their libraries
# and tests, and runs these. As nothing is written yet, every test must fail, and only for that reason.
#   new_driver.sh SOURCE
set -euo pipefail
source=$1
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { echo "$*" >&2; exit 1; }
logged() { "$@" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "failed: $*"; }; }

mkdir "$work/abcal"
(cd "$source" && tar -c --exclude=./build --exclude=./.git .) | tar -x -C "$work/abcal"
cd "$work/abcal"
drivers=(new_stage new_accelerometer)
logged scripts/new-driver new_stage stage
logged scripts/new-driver new_accelerometer accelerometer
if scripts/new-driver new_stage stage >"$work/log" 2>&1; then fail "scripts/new-driver overwrites a driver"; fi

# The files are formatted, and each includes only what a driver may.
logged clang-format --dry-run -Werror drivers/new_*/*.{h,cc} sim/firmware/new_*.{h,cc} tests/drivers/new_*/*.cc \
  tests/fuzz/new_*.cc app/measure/bench/make_firmware.cc
logged cmake -DSOURCE_DIR="$PWD" -P tests/layering_check.cmake

# Built as a release, as most of its objects are in the compiler cache.
logged cmake --preset release-ci
targets=(abcal_drivers abcal_make_firmware)
for driver in "${drivers[@]}"; do
  targets+=("abcal_$driver" "${driver}_test" "${driver}_codec_fuzz_test")
done
logged cmake --build build/release --target "${targets[@]}"

for driver in "${drivers[@]}"; do
  for test in "tests/drivers/$driver/${driver}_test" "tests/fuzz/${driver}_codec_fuzz_test"; do
    if "build/release/$test" >"$work/log" 2>&1; then fail "$test passes although nothing is written yet"; fi
    failed=$(grep -c '^\[  FAILED  \] .*ms)$' "$work/log" || true)
    excused=$(grep -c 'not written yet' "$work/log" || true)
    if [ "$failed" -eq 0 ] || [ "$excused" -lt "$failed" ]; then
      cat "$work/log" >&2
      fail "$test: $failed tests fail, $excused of them with \"not written yet\""
    fi
    echo "$test: $failed tests say \"not written yet\""
  done
done
