#!/usr/bin/env bash
# scripts/test_summary.py in CI: a skip for a listed reason passes, any other fails, whether of a test program or of ctest.
#   test_summary.sh PYTHON SUMMARY
set -euo pipefail
results=$(mktemp -d)
trap 'rm -rf "$results"' EXIT
mkdir "$results/ctest"
program_skips() {
  printf '<testsuites><testsuite><testcase name="Runs" status="run" result="completed" classname="A"/><testcase name="Skips" status="run" result="skipped" classname="A"><skipped message="a.cc:1&#x0A;%s"/></testcase></testsuite></testsuites>' "$1" >"$results/a_test.xml"
}
ctest_skips() {
  printf '<testsuite><testcase name="%s" status="run"/><testcase name="b" status="notrun"><skipped message="SKIP_RETURN_CODE=77"/><system-out>line&#x0A;%s&#x0A;</system-out></testcase></testsuite>' a_test "$1" >"$results/ctest/all.xml"
}
# expect CODE WORDS: the exit code in CI, and what is printed.
expect() {
  code=0
  printed=$(CI=true "$python" "$summary" "$results" 2>&1) || code=$?
  [ "$code" = "$1" ] && grep -qF -- "$2" <<<"$printed" || { printf 'exit code %s, required %s, with "%s":\n%s\n' "$code" "$1" "$2" "$printed" >&2; exit 1; }
}
python=$1 summary=$2
listed="ASCII-2 has no messages"
program_skips "$listed"
ctest_skips "$listed"
expect 0 "1 passed, 0 failed, 1 skipped; skipped tests of ctest: 1"
program_skips "weasyprint is not installed"
expect 1 "A.Skips: weasyprint is not installed (tests/allowed_skips"
CI=false "$python" "$summary" "$results" >/dev/null
program_skips "$listed"
ctest_skips "skipped: the site is not built"
expect 1 "b: skipped: the site is not built (tests/allowed_skips"
ctest_skips "test_x (a.B) ... skipped 'python3-pandas is not installed'&#x0A;OK (skipped=1)"
expect 1 "b: python3-pandas is not installed (tests/allowed_skips"
program_skips "shared data file a/b.csv is absent; set ABCAL_TEST_DATA to its folder"
ctest_skips "$listed"
expect 0 "shared data file a/b.csv"
