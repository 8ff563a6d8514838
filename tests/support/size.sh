#!/usr/bin/env bash
# scripts/size in a copy of one wing: within its budget it passes, above by 2 % it is reported, above by 4 % it fails, and so does
# a wing without a budget. Comments, blank lines, tests and tables cost nothing.
#   size.sh PYTHON SOURCES
set -euo pipefail
python=$1 sources=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { printf '%s\n' "$*" >&2; exit 1; }
size() { "$python" "$sources/scripts/size" "$@" "$work"; }
# tokens_and_lines WING
tokens_and_lines() { size --json | "$python" -c 'import json, sys; c = json.load(sys.stdin)["wings"][sys.argv[1]]; print(c["tokens"], c["lines"])' "$1"; }
# expect CODE WORDS: the exit code of --check, and what is printed; no words: nothing.
expect() {
  code=0
  printed=$(size --check) || code=$?
  [ "$code" = "$1" ] || fail "exit code $code, required $1: $printed"
  if [ -z "$2" ]; then [ -z "$printed" ] || fail "printed: $printed"; else grep -qF -- "$2" <<<"$printed" || fail "\"$2\" is not in: $printed"; fi
}
# counts FILE TOKENS LINES: what the file on standard input is counted as.
counts() {
  mkdir -p "$work/drivers/one"
  cat >"$work/drivers/one/$1"
  found=$(tokens_and_lines drivers/one)
  rm -r "$work/drivers"
  [ "$found" = "$2 $3" ] || fail "$1: tokens and lines $found, required $2 $3"
}
# grow PERCENT: declarations of three tokens each, as many per cent of the wing.
grow() { for ((i = 0; i < tokens * $1 / 300; i++)); do echo "int x;"; done >"$work/protocol/plan/grown.h"; }

mkdir -p "$work/protocol" "$work/docs"
cp -r "$sources/protocol/plan" "$work/protocol/plan"
echo "int x;" >"$work/protocol/wing.h"
touch "$work/CMakeLists.txt" "$work/docs/size.md"
read -r tokens _ < <(tokens_and_lines protocol/plan)
printf '| `.` | 1 |\n| `protocol` | 100 |\n| `protocol/plan` | %s |\n| `total` | %s |\n' "$tokens" $((2 * tokens)) >"$work/docs/size.md"

expect 0 ""
grow 2
expect 0 "warning: protocol/plan has "
grow 4
expect 1 "failure: protocol/plan has "
sed -i "s/^| .total. .*/| \`total\` | $((tokens + 3)) |/" "$work/docs/size.md"
rm "$work/protocol/plan/grown.h"
grow 2
expect 0 "warning: total has "
grow 4
expect 1 "failure: total has "
rm "$work/protocol/plan/grown.h"
for ((i = 0; i < tokens; i++)); do printf '// A comment.\n\n'; done >"$work/protocol/plan/comments.h"
mkdir -p "$work/tests/protocol" "$work/app/console/page"
grow 10
mv "$work/protocol/plan/grown.h" "$work/tests/protocol/grown_test.cc"
for ((i = 0; i < tokens; i++)); do echo "'a': 'b',"; done >"$work/app/console/page/de.js"
expect 0 ""
mkdir -p "$work/drivers/new"
echo "int x;" >"$work/drivers/new/driver.cc"
expect 1 "failure: drivers/new has 3 tokens and no budget"
rm -r "$work/drivers"
printf '| `drivers/old` | 100 |\n' >>"$work/docs/size.md"
expect 0 "warning: drivers/old has a budget in docs/size.md and no code"

# In each language a string is one token and a comment is not counted. The code within a template string of JavaScript is.
counts a.cc 15 4 <<'END'
#include <a.h>  // a comment
/* of several
   lines */
const char* a = R"x(a "string" //
of lines)x";
int b = 1'000; /* comment */
END
counts a.js 20 3 <<'END'
// comment
const a = `b // ${c + `d${e}`} f`;
const b = /"/;
/* } */ f();
END
counts a.py 12 3 <<'END'
"""Of lines
"""
# a comment
a = f"b # {c}"
def b():
    """A comment."""
    return a // 2
END
counts a.sh 11 4 <<'END'
# a comment
a "b # c" $#  # a comment
cat <<HERE
a 'b # c
HERE
END
counts a.cmake 5 1 <<'END'
# a comment
set(a "b # c") # comment
END
