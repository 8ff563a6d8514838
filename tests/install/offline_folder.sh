#!/usr/bin/env bash
# Installs abcal from a signed folder on this fresh system without a network, again, and as an upgrade; and verifies what is refused.
#   offline_folder.sh FOLDER FINGERPRINT     FOLDER/own is for this release of Debian, FOLDER/other for another one
set -euo pipefail
folder=${1:?} fingerprint=${2:?}
if [ "${ABCAL_WITHOUT_NETWORK:-}" != yes ]; then ABCAL_WITHOUT_NETWORK=yes exec unshare --net bash "$0" "$@"; fi
fail() { echo "$*" >&2; exit 1; }
if apt-get update -o Acquire::Retries=0 2>&1 | grep -q '^Get:'; then fail "this system has a network"; fi
rm -f /var/lib/apt/lists/*Packages*  # as on a computer that never had one

# refused WORDS COMMAND...: the command fails with these words, and nothing is installed.
refused() {
  local words=$1
  shift
  if "$@" >/tmp/refused.log 2>&1; then fail "not refused: $*"; fi
  grep -qF -- "$words" /tmp/refused.log || { cat /tmp/refused.log >&2; fail "refused without the words \"$words\": $*"; }
  if dpkg-query -W abcal >/dev/null 2>&1; then fail "refused, but abcal is installed: $*"; fi
  echo "refused: $(grep -F -- "$words" /tmp/refused.log)"
}
refused "the laboratory's key is not given" sh "$folder/own/install"
wrong=$(printf '%s' "$fingerprint" | tr 0123 1230)
refused "signed by another key" sh "$folder/own/install" --fingerprint "$wrong"
refused "has 8 digits" sh "$folder/own/install" --fingerprint "${fingerprint: -8}"
refused "this folder is for Debian" sh "$folder/other/install" --fingerprint "$fingerprint"
# One byte of a package, in the middle of it.
cp -a "$folder/own" /tmp/changed
package=$(cd /tmp/changed && ls packages/libsodium23_*.deb)
offset=$(($(stat -c %s "/tmp/changed/$package") / 2))
byte=$(od -An -tu1 -j $offset -N 1 "/tmp/changed/$package")
printf "\\$(printf %o $(((byte + 1) % 256)))" | dd of="/tmp/changed/$package" bs=1 seek=$offset conv=notrunc status=none
refused "$package (changed)" sh /tmp/changed/install --fingerprint "$fingerprint"
# The same, with its checksum in the list.
(cd /tmp/changed && sha256sum "$package" >/tmp/sum && sed -i "s,^[0-9a-f]*  $package\$,$(cat /tmp/sum)," SHA256SUMS)
refused "does not have a valid signature" sh /tmp/changed/install --fingerprint "$fingerprint"
rm -rf /tmp/changed

try() {
  (
    cd "$(mktemp -d)"
    abcal --version
    abcal demo --help >/dev/null
    abcal run /usr/share/doc/abcal/examples/simulated.toml -o first.run >run.log 2>&1 || { tail -n 20 run.log >&2; exit 1; }
    abcal verify first.run >/dev/null
    abcal report first.run --pdf first.pdf >report.log 2>&1 || { tail -n 20 report.log >&2; exit 1; }
    [ "$(head -c 5 first.pdf)" = %PDF- ]
    python3 -c 'import abcal; assert abcal.analyse(abcal.load("first.run")).verdict == "usable"'
  )
  [ -z "$(dpkg --audit)" ] || fail "dpkg --audit: $(dpkg --audit)"
}
began=$SECONDS
sh "$folder/own/install" --fingerprint "$(printf '%s' "$fingerprint" | sed 's/..../& /g')"
echo "-- installed in $((SECONDS - began)) s"
try
version() { dpkg-query -W -f='${Version}' abcal; }
offered=$(version)

# Again, with the key as a file: nothing changes.
before=$(dpkg-query -W)
sh "$folder/own/install" --keyring "$folder/own/laboratory-key.gpg"
[ "$(dpkg-query -W)" = "$before" ] || fail "installing again changed the packages"
# Over an older version of the same packages.
mkdir /tmp/older
for file in "$folder"/own/packages/{abcal,abcal-doc,libabcal1,python3-abcal}_*.deb; do
  dpkg-deb -R "$file" /tmp/older/tree
  sed -i "s/$offered/0.9.0-1/g" /tmp/older/tree/DEBIAN/control
  dpkg-deb -b /tmp/older/tree "/tmp/older/$(basename "$file")" >/dev/null
  rm -r /tmp/older/tree
done
dpkg -i --force-downgrade /tmp/older/*.deb >/tmp/dpkg.log 2>&1 || { cat /tmp/dpkg.log >&2; exit 1; }
[ "$(version)" = 0.9.0-1 ] || fail "the older version is not installed"
sh "$folder/own/install" --fingerprint "$fingerprint" libabcal-dev
[ "$(version)" = "$offered" ] || fail "not upgraded: abcal $(version), required $offered"
dpkg-query -W libabcal-dev >/dev/null
try
. /etc/os-release
echo "The folder installs abcal $offered on $PRETTY_NAME without a network."
