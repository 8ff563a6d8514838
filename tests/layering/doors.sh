#!/usr/bin/env bash
# A forbidden include does not compile: tries one in each wing and some layers, with the include root that its target has,
# and also a permitted one.
#   doors.sh COMPILER DOORS
set -euo pipefail
compiler=$1
doors=$(realpath "$2")
failed=0
# The compiler searches the folder of the source first, here the current one.
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"

# try LAYER HEADER: the compiler's messages for an include of the header, in a source of the layer.
try() { printf '#include "%s"\n' "$2" | "$compiler" -std=c++20 -fsyntax-only -x c++ -I "$doors/${1//\//_}" - 2>&1 || true; }

check() {
  local layer=$1 permitted=$2 forbidden=$3
  if ! try "$layer" "$forbidden" | grep -q "$forbidden: No such file"; then
    echo "$layer: $forbidden is forbidden and compiles"
    failed=1
  fi
  if try "$layer" "$permitted" | grep -q "$permitted: No such file"; then
    echo "$layer: $permitted is permitted and is not found"
    failed=1
  fi
}

check drivers/instrument drivers/instrument/clock.h drivers/wire/byte_stream.h
check drivers/pi_gcs drivers/wire/byte_stream.h drivers/zaber_ascii/codec.h
check protocol/estimators protocol/plan/limits.h drivers/instrument/rotation_stage.h
check protocol/run drivers/instrument/clock.h protocol/estimators/circle/abc_estimator.h
check sim drivers/instrument/clock.h protocol/plan/limits.h
check app/system drivers/instrument/clock.h app/formats/xml_tree.h
check app/bench_file app/system/exit_code.h app/measure/session/measuring_session.h
check app/measure app/system/exit_code.h app/results/analysis/analyses.h
check app/measure app/system/exit_code.h app/laboratory/register/login.h
check app/results app/system/exit_code.h app/measure/session/measuring_session.h
check app/results app/system/exit_code.h app/laboratory/certificate/certificate.h
check app/laboratory app/results/analysis/analyses.h app/measure/session/measuring_session.h
check app/studies app/results/analysis/analyses.h app/laboratory/certificate/certificate.h
check app/console app/measure/session/measuring_session.h app/studies/trials/measured_run.h
check app/commands app/measure/session/measuring_session.h tests/support/error_of.h
exit "$failed"
