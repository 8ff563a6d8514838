#!/usr/bin/env bash
# Reads the symbols and the sizes of the helper programs: each contains only the code that it calls.
#   helper_programs.sh BUILD
set -euo pipefail
cd "$1"
failed=0
for program in abcal-guard abcal-hdf5 abcal-mat abcal-mpi abcal-pdf abcal-sign abcal-transfer; do
  [ -e "$program" ] || continue  # MPI may be absent.
  symbols=$(nm -C --defined-only "$program")
  case $program in
    abcal-guard) forbidden='abcal::(sim|lab)::|abcal::make_bench|abcal::BenchConfig::' ;;
    # These two analyse a run with its bench file, and know all drivers by it.
    abcal-mpi|abcal-hdf5) forbidden='abcal::lab::|abcal::MeasuringSession::' ;;
    *) forbidden='abcal::(sim|lab)::|abcal::MeasuringSession::' ;;
  esac
  if found=$(grep -m3 -E "$forbidden" <<<"$symbols"); then
    printf '%s holds what it never calls:\n%s\n' "$program" "$found"
    failed=1
  fi
  size=$(stat -c %s "$program")
  printf '%s: %d bytes\n' "$program" "$size"
done
exit "$failed"
