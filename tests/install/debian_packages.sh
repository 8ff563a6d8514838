#!/usr/bin/env bash
# Makes the packages of a build and examines them.   debian_packages.sh CPACK BUILD
set -euo pipefail
cpack=$1 build=$2
command -v dpkg-deb >/dev/null && command -v dpkg-shlibdeps >/dev/null || { echo "no dpkg-dev"; exit 77; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
"$cpack" -G DEB --config "$build/CPackConfig.cmake" -B "$work" >"$work/log" 2>&1 || { cat "$work/log"; exit 1; }

fail() { echo "$*" >&2; exit 1; }
program=$(ls "$work"/abcal_*.deb) library=$(ls "$work"/libabcal-dev_*.deb)
field() { dpkg-deb -f "$1" "$2"; }
[ "$(field "$program" Section)" = science ] || fail "section: $(field "$program" Section)"
[ "$(field "$program" Maintainer)" = "abcal maintainers <maintainers@example.org>" ] || fail "maintainer"
case "$(field "$program" Depends)" in *libc6*libserialport0*|*libserialport0*libc6*) ;; *) fail "depends: $(field "$program" Depends)" ;; esac

contents() { dpkg-deb -c "$1" | awk '{print $6}'; }
contents "$program" >"$work/program.list"
contents "$library" >"$work/library.list"
for file in usr/bin/abcal usr/libexec/abcal/abcal-hdf5 usr/libexec/abcal/abcal-mat usr/libexec/abcal/abcal-transfer usr/libexec/abcal/abcal-pdf usr/libexec/abcal/abcal-sign usr/share/abcal/schemas/v3.3.0/dcc.xsd usr/share/man/man1/abcal.1.gz usr/share/man/man1/abcal-run.1.gz \
    usr/share/bash-completion/completions/abcal usr/share/zsh/vendor-completions/_abcal \
    usr/lib/udev/rules.d/60-abcal.rules usr/lib/systemd/system/abcal-console.service \
    usr/lib/systemd/system/abcal-bench.service usr/lib/systemd/system/abcal-witness.service \
    usr/libexec/abcal/abcal-guard usr/libexec/abcal/abcal-witness \
    usr/share/doc/abcal/copyright \
    usr/share/doc/abcal/changelog.gz usr/share/doc/abcal/changelog.Debian.gz; do
  grep -qx "./$file" "$work/program.list" || fail "the package abcal has no $file"
done
pages=$(ls "$work"/abcal-doc_*_all.deb)
contents "$pages" >"$work/pages.list"
for file in certificate.md theory/model.md decisions/0001-exceptions-for-instrument-faults.md examples/simulated.toml images/certificate.png \
    notebooks/what_wobble_does.ipynb; do
  grep -qx "./usr/share/doc/abcal/$file" "$work/pages.list" || fail "the package abcal-doc has no $file"
done
if grep -E 'share/doc/.*\.(md|png|ipynb)$' "$work/program.list"; then fail "these belong into abcal-doc"; fi
if grep 'examples/cpp' "$work/pages.list"; then fail "these belong into libabcal-dev"; fi
for file in usr/include/abcal/protocol/estimators/circle/abc_estimator.h; do
  grep -qx "./$file" "$work/library.list" || fail "the package libabcal-dev has no $file"
done
grep -q '/cmake/abcal/abcal-config.cmake$' "$work/library.list" || fail "libabcal-dev has no abcal-config.cmake"
grep -q '/libabcal_estimators.a$' "$work/library.list" || fail "libabcal-dev has no libabcal_estimators.a"
runtime=$(ls "$work"/libabcal1_*.deb)
contents "$runtime" >"$work/runtime.list"
grep -q '^\./usr/lib/.*libabcal\.so\.1$' "$work/runtime.list" || fail "libabcal1 has no libabcal.so.1"
if grep -q 'libabcal\.so$' "$work/runtime.list"; then fail "libabcal.so belongs into libabcal-dev"; fi
grep -q '/libabcal\.so$' "$work/library.list" || fail "libabcal-dev has no libabcal.so"
grep -qx './usr/include/abcal/record.h' "$work/library.list" || fail "libabcal-dev has no abcal/record.h"
case "$(field "$library" Depends)" in *"libabcal1 (= "*) ;; *) fail "libabcal-dev depends: $(field "$library" Depends)" ;; esac
packages=("$program" "$pages" "$library" "$runtime")
if python=$(ls "$work"/python3-abcal_*.deb 2>/dev/null); then
  packages+=("$python")
  contents "$python" >"$work/python.list"
  grep -qx './usr/lib/python3/dist-packages/abcal/__init__.pyi' "$work/python.list" || fail "python3-abcal has no stubs"
fi
if grep -E '\.(a|h|cmake)$' "$work/program.list"; then fail "these belong into libabcal-dev"; fi
# Unpacked once: a reader that ends early would break the pipe of dpkg-deb.
dpkg-deb -x "$program" "$work/root"
dpkg-deb -x "$pages" "$work/root"
services=$work/root/usr/lib/systemd/system
grep -q '^ExecStart=/usr/bin/abcal serve /etc/abcal/bench.toml' "$services/abcal-console.service" || fail "the service starts another program"
grep -q '^ExecStart=/usr/libexec/abcal/abcal-witness ' "$services/abcal-witness.service" || fail "the witness is started from another place"
# The exposure of the services to attacks: systemd's figure, 0 to 10.
if command -v systemd-analyze >/dev/null; then
  for service in abcal-bench abcal-console abcal-witness; do
    systemd-analyze security --offline=true --threshold=20 --no-pager "$services/$service.service" >"$work/exposure" ||
      fail "$service.service: $(tail -1 "$work/exposure"); required: at most 2.0"
  done
fi
# The service is installed, but not enabled.
if grep -q 'systemd/system/.*\.wants/' "$work/program.list"; then fail "the service is enabled"; fi

# The packaged program works, from an empty folder, with the examples of their package.
mkdir "$work/empty" && cd "$work/empty"
"$work/root/usr/bin/abcal" plan "$work/root/usr/share/doc/abcal/examples/simulated.toml" >/dev/null
# The module for Python works, with the library of its package.
if [ -n "$python" ]; then
  dpkg-deb -x "$runtime" "$work/root"
  dpkg-deb -x "$python" "$work/root"
  folder=$(dirname "$(find "$work/root/usr/lib" -name libabcal.so.1)")
  LD_LIBRARY_PATH=$folder PYTHONPATH=$work/root/usr/lib/python3/dist-packages PYTHONDONTWRITEBYTECODE=1 /usr/bin/python3 -c '
import abcal
result = abcal.analyse(abcal.simulate(steps=12).record)
assert result.verdict == "usable", result.why' || fail "the module for Python in its package does not work"
fi

command -v lintian >/dev/null || { echo "no lintian: contents only"; exit 0; }
lintian --allow-root --fail-on error "${packages[@]}" || fail "lintian finds errors"
