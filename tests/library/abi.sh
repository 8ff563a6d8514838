#!/usr/bin/env bash
# Compares the binary interface of libabcal.so with the kept one: a program that was compiled before must go on.
#   abi.sh LIBRARY HEADERS COMPILER            compares
#   abi.sh --keep LIBRARY HEADERS COMPILER     keeps it as it is now: for a new first number of its version
set -euo pipefail
baseline=$(dirname "$0")/libabcal.so.1.abi.xz
keep=no
[ "$1" != --keep ] || { keep=yes; shift; }
library=$1 headers=$2 compiler=$3
command -v abidw >/dev/null || { echo "no abidw: install abigail-tools"; exit 77; }
# Other compilers describe the same types in other words.
case $compiler in GNU-12.*) ;; *) echo "the kept interface is that of GCC 12, this is $compiler"; exit 77 ;; esac
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
write() { abidw --headers-dir "$headers" --drop-private-types --no-comp-dir-path --no-corpus-path --no-show-locs "$1"; }
if [ "$keep" = yes ]; then
  write "$library" | xz -9 >"$baseline"
  exit 0
fi
write "$library" >"$work/now.abi"
xz -dc "$baseline" >"$work/kept.abi"
# Names may be added; what is removed or changed breaks programs.
if ! abidiff --no-added-syms "$work/kept.abi" "$work/now.abi" >"$work/log"; then
  cat "$work/log"
  echo "The binary interface of libabcal.so.1 has changed. Required: the old one, or a new soname (docs/library.md)." >&2
  exit 1
fi
# The library exports only its own names and those that external drivers need.
readelf --dyn-syms --wide "$library" | awk '$5 == "GLOBAL" && $7 != "UND" || $5 == "WEAK" && $7 != "UND" {print $8}' |
  c++filt >"$work/shown"
if grep -vE '(^| )abcal::(v1|InstrumentError)::|for abcal::(v1|InstrumentError)|^abcal::to_string\(abcal::Fault\)|^abcal::in_words' "$work/shown"; then
  echo "these names are shown and should not be" >&2
  exit 1
fi
