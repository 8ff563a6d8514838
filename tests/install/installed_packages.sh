#!/usr/bin/env bash
# Installs the packages of a folder on this fresh system, and uses their contents.
#   installed_packages.sh FOLDER
set -euo pipefail
folder=${1:?}
export DEBIAN_FRONTEND=noninteractive
apt-get update -qq
apt-get install -y -qq --no-install-recommends "$folder"/abcal_*.deb "$folder"/abcal-doc_*.deb "$folder"/libabcal1_*.deb \
  "$folder"/python3-abcal_*.deb >/tmp/install.log 2>&1 || { tail -n 20 /tmp/install.log >&2; exit 1; }
[ -z "$(dpkg --audit)" ] || { dpkg --audit >&2; exit 1; }
# Runs outside of the sources.
cd "$(mktemp -d)"
abcal --version
abcal run /usr/share/doc/abcal/examples/simulated.toml -o first.run >run.log 2>&1 || { tail -n 20 run.log >&2; exit 1; }
abcal verify first.run >/dev/null
abcal docs | grep -q 'file:///usr/share/doc/abcal/site/index.html' || { echo "abcal docs names no site" >&2; exit 1; }
test -s /usr/share/doc/abcal/site/search_index.js
python3 -c 'import abcal'
python3 - first.run <<'PYTHON'
import sys

import abcal

result = abcal.analyse(abcal.load(sys.argv[1]))
assert result.verdict == "usable", result.why
print("import abcal:", abcal.__file__)
PYTHON
. /etc/os-release
echo "The packages work on $PRETTY_NAME."
