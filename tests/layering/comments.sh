#!/usr/bin/env bash
# A comment is a sentence, or a phrase headed by its noun: none begins with "Of" or "What", which only the code could complete.
#   comments.sh SOURCES
set -euo pipefail
cd "$1"
if found=$(grep -rnE '//+[!?]?<? *(Of|What)\b' --include='*.cc' --include='*.h' --include='*.js' --include='*.mjs' \
    app drivers protocol sim tests); then
  printf 'These comments need a subject:\n%s\n' "$found"
  exit 1
fi
