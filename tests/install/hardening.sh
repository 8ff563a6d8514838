#!/bin/sh
# The program as it was linked: position-independent, its relocations resolved and read-only at the start, with checked
# copies and stack protectors; without the libraries that make every start slow.
set -eu
program=$1
failed=0
expect() {  # what, pattern, text
  if ! printf '%s\n' "$3" | grep "$2" >/dev/null; then
    echo "$program: $1 is missing (no $2)" >&2
    failed=1
  fi
}
expect 'position-independent code' 'Type: *DYN' "$(LC_ALL=C readelf --file-header "$program")"
expect 'read-only relocations' GNU_RELRO "$(LC_ALL=C readelf --program-headers "$program")"
expect 'binding at the start' 'FLAGS.*NOW' "$(LC_ALL=C readelf --dynamic "$program")"
symbols=$(LC_ALL=C readelf --dyn-syms --wide "$program")
expect 'the stack protector' __stack_chk_fail "$symbols"
expect 'checked copies' '__mem[a-z]*_chk\|__read_chk\|__snprintf_chk' "$symbols"
for library in libhwy libhdf5 libmpi libxmlsec; do
  if LC_ALL=C readelf --dynamic "$program" | grep "NEEDED.*$library" >/dev/null; then
    echo "$program: loads $library at every start" >&2
    failed=1
  fi
done
exit "$failed"
