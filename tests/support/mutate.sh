#!/usr/bin/env bash
# scripts/mutate in a tree of one file: which places it changes and how. Comments, strings, lines of the preprocessor, templates,
# signs, hexadecimal and octal numbers are no places; a change that tests/equivalent_mutations names is left out. The same seed gives the same order.
#   mutate.sh PYTHON SOURCES
set -euo pipefail
python=$1 sources=$2
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
fail() { printf '%s\n' "$*" >&2; exit 1; }
mkdir -p "$work/scripts" "$work/tests" "$work/drivers"
cp "$sources/scripts/mutate" "$sources/scripts/size" "$work/scripts"
printf '# Why.\ndrivers/a.cc: if ({{a && *b > 0}}) return {};\n' >"$work/tests/equivalent_mutations"
cat >"$work/drivers/a.cc" <<'END'
#define X 1 < 2  // 3 < 4
const char* a = "5 < 6";
std::vector<int> f(int a, const int* b) {
  if (a && *b > 0) return {};
  while (const int c = 1'000) return g<7>(-a, c - 20U);
  if constexpr (sizeof(a) <= 0x10) return a += 1e-3;
  if (!b) return {}, 0666;
}
END
list() { "$python" "$work/scripts/mutate" --list "$@" "$work/drivers"; }
# By 1 or 10 %, by lot: MORE.
found=$(list | sed -E 's/(0\.00101|0\.0011|1010|1100|22|21)$/MORE/' | sort)
required=$(sort <<'END'
drivers/a.cc:4: if (a {{&&}} *b > 0) return {};  ->  ||
drivers/a.cc:4: if (a && *b {{>}} 0) return {};  ->  >=
drivers/a.cc:4: if (a && *b > {{0}}) return {};  ->  1
drivers/a.cc:5: while (const int c = {{1'000}}) return g<7>(-a, c - 20U);  ->  MORE
drivers/a.cc:5: while (const int c = 1'000) return g<7>(-a, c {{-}} 20U);  ->  +
drivers/a.cc:5: while (const int c = 1'000) return g<7>(-a, c - {{20}}U);  ->  MORE
drivers/a.cc:6: if constexpr (sizeof(a) {{<=}} 0x10) return a += 1e-3;  ->  <
drivers/a.cc:6: if constexpr (sizeof(a) <= 0x10) return a {{+=}} 1e-3;  ->  -=
drivers/a.cc:6: if constexpr (sizeof(a) <= 0x10) return a += {{1e-3}};  ->  MORE
drivers/a.cc:7: if ({{!b}}) return {}, 0666;  ->  !(!b)
END
)
diff <(echo "$required") <(echo "$found") || fail "these places are not those required"
[ "$(list --seed 2)" = "$(list --seed 2)" ] || fail "the same seed gives other places"
[ "$(list --seed 2)" != "$(list --seed 3)" ] || fail "another seed gives the same places"

own=()
[ "$(id -u)" = 0 ] || own=(--user --map-root-user)
if ! unshare "${own[@]}" --mount true 2>/dev/null; then
  echo "this system lets nobody mount an overlay; only the places were checked"
  exit 77
fi
# With programs in the place of cmake, ninja and ctest: a change to -= does not compile, one to || is noticed by its test, no other.
mkdir -p "$work/bin" "$work/build/release" "$work/tests/drivers"
touch "$work/build/release/build.ninja"
echo '#include "drivers/a.h"' >"$work/tests/drivers/a_test.cc"
cat >"$work/bin/cmake" <<'END'
#!/usr/bin/env bash
mkdir -p build/release/.cmake/api/v1/reply
cd build/release/.cmake/api/v1/reply
echo '{"configurations": [{"targets": [{"jsonFile": "a.json"}, {"jsonFile": "b.json"}]}]}' >codemodel-v2-1.json
echo '{"name": "a_test", "sources": [{"path": "tests/drivers/a_test.cc"}]}' >a.json
echo '{"name": "b", "sources": [{"path": "drivers/a.cc"}]}' >b.json
END
cat >"$work/bin/ninja" <<'END'
#!/usr/bin/env bash
[ "$*" = "-C build/release a_test" ] && ! grep -q -- '-= 1e-3' drivers/a.cc
END
cat >"$work/bin/ctest" <<'END'
#!/usr/bin/env bash
case $* in
  *--show-only*) echo '{"tests": [{"command": ["build/release/tests/drivers/a_test", "-v"]}, {"name": "not built"}]}' ;;
  *'-R ^(a_test)'*) ! grep -qF '||' drivers/a.cc ;;
  *) exit 1 ;;
esac
END
chmod +x "$work/bin/cmake" "$work/bin/ninja" "$work/bin/ctest"
cp "$work/drivers/a.cc" "$work/before"
code=0
found=$(PATH=$work/bin:$PATH "$python" "$work/scripts/mutate" "$work/drivers" 2>&1) || code=$?
[ "$code" = 1 ] || fail "exit code $code, required 1: $found"
cmp "$work/before" "$work/drivers/a.cc" || fail "a changed source is left"
[ ! -e "$work/build/release/.cmake" ] || fail "the build folder is not as it was"
for words in 'a {{&&}} *b > 0) return {};  ->  || noticed' '{{+=}} 1e-3;  ->  -= does not compile' \
  '*b {{>}} 0) return {};  ->  >= NOT NOTICED by a_test' '9 changes, 1 noticed.'; do
  grep -qF -- "$words" <<<"$found" || fail "\"$words\" is not in: $found"
done
PATH=$work/bin:$PATH "$python" "$work/scripts/mutate" --least 11 "$work/drivers" >"$work/output" || fail "one of nine is more than 11 %: $(cat "$work/output")"
