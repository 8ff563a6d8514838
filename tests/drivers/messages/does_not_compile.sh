#!/usr/bin/env bash
# Faults of messages do not compile: a text of a person as a sentence, a sentence whose places are not those of its values.
#   does_not_compile.sh COMPILER DOORS
set -euo pipefail
compiler=$1
door=$(realpath "$2")/app_laboratory
failed=0

# compiles STATEMENTS: whether they compile in a function of the certificate.
compiles() {
  printf '#include "app/laboratory/certificate/words.h"
using namespace abcal;
void certificate(const Words& words, const std::string& source, const Stated& stated) {
  (void)words, (void)source, (void)stated;
  %s
}\n' "$1" | "$compiler" -std=c++20 -fsyntax-only -x c++ -I "$door" - 2>/dev/null
}

permitted() { compiles "$1" || { echo "is permitted and does not compile: $1"; failed=1; }; }
refused() { ! compiles "$1" || { echo "compiles and is a fault: $1"; failed=1; }; }

permitted '(void)words("not stated");
  (void)words("Source: {source}", source);
  (void)words("Source: {source}", stated);
  (void)Message("{found:.3g} of {all}", 1.5, 3);'
# The text of a person is no sentence, and no catalogue accepts it.
refused '(void)words(source);'
refused '(void)words(source.c_str());'
refused '(void)words(stated);'
refused '(void)Message(source);'
refused '(void)Message(stated);'
refused 'const char* text = source.empty() ? "one" : "two"; (void)words(text);'
# A value for each place, and a name for each value.
refused '(void)words("Source: {source}");'
refused '(void)words("Source: {source}", source, 1);'
refused '(void)words("Source: {}", source);'
refused '(void)words("Source: {source} {source}", source, source);'
refused '(void)words("Source: {source", source);'
exit "$failed"
