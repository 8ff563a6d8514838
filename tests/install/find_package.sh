#!/usr/bin/env bash
# Installs into a new folder and builds a third-party program against it.
#   find_package.sh CMAKE BUILD SOURCE COMPILER
set -euo pipefail
cmake=$1 build=$2 source=$3 compiler=$4
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

"$cmake" --install "$build" --prefix "$work/prefix" >"$work/install.log" || { cat "$work/install.log"; exit 1; }
# Nothing of the installed package may point back at where it was built.
if grep -rlF --include='*.cmake' --include='*.h' --include='*.service' -e "$source/" -e "$build/" "$work/prefix"; then
  echo "these installed files name the folder of the build" >&2
  exit 1
fi
grep -q "^ExecStart=$work/prefix/bin/abcal " "$work/prefix/lib/systemd/system/abcal-console.service" || {
  echo "the service does not start the installed program" >&2
  exit 1
}
"$cmake" -S "$source/tests/install/consumer" -B "$work/consumer" -DCMAKE_PREFIX_PATH="$work/prefix" \
  -DCMAKE_CXX_COMPILER="$compiler" -DCMAKE_BUILD_TYPE=Release >"$work/configure.log" || { cat "$work/configure.log"; exit 1; }
"$cmake" --build "$work/consumer" >"$work/build.log" || { cat "$work/build.log"; exit 1; }

# A perfect stage, an accelerometer with sensitivities 1.25, 0.5 and 2 and offsets 0.1, 0.2, 0.3.
awk 'BEGIN {
  print "experiment,n,alpha_deg,r_u,r_v,r_w"
  for (e = 1; e <= 3; ++e) for (n = 1; n <= 12; ++n) {
    a = (n - 1) * atan2(0, -1) / 6
    x = e == 1 ? 0 : -sin(a); y = e == 1 ? sin(a) : e == 2 ? 0 : -cos(a); z = e == 3 ? 0 : cos(a)
    printf "%d,%d,%d,%.17g,%.17g,%.17g\n", e, n, 30 * (n - 1), 1.25 * x + 0.1, 0.5 * y + 0.2, 2 * z + 0.3
  }
}' >"$work/readings.csv"
found=$("$work/consumer/consumer" "$work/readings.csv")
expected=$'abc 1.250000000 0.500000000 2.000000000\njoint 1.250000000 0.500000000 2.000000000'
if [ "$found" != "$expected" ]; then
  printf 'expected:\n%s\nfound:\n%s\n' "$expected" "$found" >&2
  exit 1
fi
# A driver outside of the sources, under the installed contract.
"$work/consumer/outside_driver_test" >"$work/contract.log" || { cat "$work/contract.log"; exit 1; }
# The library: both of its examples, with Eigen as the only other dependency.
# Under the address sanitizer, which makes Eigen allocate in another way unless the package prevents that.
export ASAN_OPTIONS=detect_leaks=0
for example in analysis driver; do
  "$cmake" -S "$source/docs/examples/cpp/$example" -B "$work/$example" -DCMAKE_PREFIX_PATH="$work/prefix" \
    -DCMAKE_CXX_COMPILER="$compiler" -DCMAKE_BUILD_TYPE=Debug -DCMAKE_CXX_FLAGS=-fsanitize=address >"$work/configure.log" || { cat "$work/configure.log"; exit 1; }
  "$cmake" --build "$work/$example" >"$work/build.log" || { cat "$work/build.log"; exit 1; }
done
"$work/analysis/analysis" "$work/readings.csv" >"$work/analysis.log" || { cat "$work/analysis.log"; exit 1; }
for line in 'u: 1.250000000 0.000000000 0.000000000' 'Monte Carlo: 18 outputs'; do
  tr -d - <"$work/analysis.log" | grep -xF "$line" >/dev/null || { echo "analysis says no \"$line\":" >&2; cat "$work/analysis.log" >&2; exit 1; }
done
"$work/driver/contract_test" >"$work/contract.log" || { cat "$work/contract.log"; exit 1; }
"$work/driver/calibrate" "$source/docs/examples/cpp/driver/bench.toml" "$work/factory.run" >"$work/driver.log" 2>&1 ||
  { cat "$work/driver.log"; exit 1; }
[ "$(cat "$work/driver.log")" = "18 angles, joint" ] || { cat "$work/driver.log" >&2; exit 1; }
# The installed program finds its helper programs.
(cd "$work" && prefix/bin/abcal report readings.csv --hdf5 readings.h5 >report.log 2>&1) || { cat "$work/report.log"; exit 1; }
# The installed program and the library give the same result.
# By way of a file: grep -q closes a pipe before everything is written, which abcal reports as a failure.
"$work/prefix/bin/abcal" analyse "$work/readings.csv" --json >"$work/result.json"
grep -q '"estimator": "joint"' "$work/result.json"
