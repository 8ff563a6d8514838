#!/usr/bin/env bash
# Reads the symbols and the sizes of the helper programs: each contains only the code that it calls, and none is large.
#   helper_programs.sh BUILD
set -euo pipefail
cd "$1"
failed=0
for program in abcal-guard abcal-hdf5 abcal-mat abcal-mpi abcal-pdf abcal-sign abcal-transfer abcal-witness; do
  [ -e "$program" ] || continue  # MPI may be absent.
  symbols=$(nm -C --defined-only "$program")
  most=1500000  # bytes
  case $program in
    abcal-guard) forbidden='abcal::(sim|lab)::|abcal::make_bench|abcal::BenchConfig::' ;;
    # It loads a run and does all of a Monte Carlo study, of the joint result too: all estimators and their linear algebra,
    # distributions, the trials, and their products of 40 at a time, for each kind of processor. That is 3.2 MB, and the symbols of it are 1.5 MB. It reads the bench
    # file that a run keeps, to see that a record is of its stage: 1.7 MB, with the draw of a simulated truth; tables and logs: 0.3 MB. The messages of
    # verdicts, notes and checks, with named values: 0.2 MB. It finds and fits the runs of a measurement: 0.1 MB. Descriptions of
    # stages, which are a part of the bench file: 0.2 MB.
    abcal-mpi)
      forbidden='abcal::lab::|abcal::MeasuringSession::'
      most=7850000
      ;;
    # These are given the results: they know neither runs nor benches nor estimators.
    *) forbidden='abcal::(sim|lab)::|abcal::(MeasuringSession|BenchConfig|RunFile)::|abcal::(analyse|fit)_|abcal::(make_budget|parse_bench)' ;;
  esac
  if found=$(grep -m3 -E "$forbidden" <<<"$symbols"); then
    printf '%s holds what it never calls:\n%s\n' "$program" "$found"
    failed=1
  fi
  size=$(stat -c %s "$program")
  printf '%s: %d bytes\n' "$program" "$size"
  if [ "$size" -gt "$most" ]; then
    printf '%s: %d bytes; required: at most %d\n' "$program" "$size" "$most"
    failed=1
  fi
done
exit "$failed"
