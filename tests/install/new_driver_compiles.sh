#!/usr/bin/env bash
# Makes a stage driver and an accelerometer driver with scripts/new-driver in a copy of the sources, and compiles what it
# writes as far as the compiler's errors: new_driver.sh, which takes minutes, also builds and runs it.
#   new_driver_compiles.sh SOURCE COMPILER INCLUDE_FOLDER...
set -euo pipefail
source=$1 compiler=$2
shift 2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

(cd "$source" && tar -c app/measure/bench drivers scripts/new-driver sim docs/drivers docs/udev tests/drivers tests/fuzz) | tar -x -C "$work"
cd "$work"
scripts/new-driver new_stage stage >log
scripts/new-driver new_accelerometer accelerometer >>log
includes=(-I.)
for folder in "$@"; do [ -z "$folder" ] || includes+=(-isystem "$folder"); done
bad=0
for file in drivers/new_*/*.cc sim/firmware/new_*.cc tests/drivers/new_*/*.cc tests/fuzz/new_*.cc; do
  "$compiler" -std=c++20 -fsyntax-only -Wall -Wextra -Wpedantic -Wconversion -Wshadow -Werror "${includes[@]}" "$file" || { echo "$file: does not compile" >&2; bad=1; }
done
exit $bad
