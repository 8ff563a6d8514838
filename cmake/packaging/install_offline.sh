#!/bin/sh
# Installs abcal from this folder on a computer without a network. Before anything is installed, it verifies that the folder is the
# one that the laboratory signed: the signature of SHA256SUMS, then the checksum of every file in it.
#   sudo sh FOLDER/install --fingerprint 'F...' [PACKAGE...]   the fingerprint of the laboratory's key, from paper
#   sudo sh FOLDER/install --keyring FILE [PACKAGE...]         or that key as a file, which did not come with this folder
#   sh FOLDER/install --check --fingerprint 'F...'             verifies only, without root
# PACKAGE: further packages of the folder, e.g. libabcal-dev.
# This script came with the folder. Who does not want to trust it either verifies by hand first; README.txt says how.
set -eu
export LC_ALL=C.UTF-8
fail() {
  printf 'install: %s\n' "$1" >&2
  shift
  for line in "$@"; do printf '  %s\n' "$line" >&2; done
  printf '  Nothing was installed.\n' >&2
  exit 1
}
usage() { sed -n '4,7s/^# \{0,1\}//p' "$0" >&2; exit 2; }

source=$(cd "$(dirname "$0")" && pwd)
check_only=no
required=
keyring=
while [ $# -gt 0 ]; do
  case $1 in
    --check) check_only=yes; shift ;;
    --fingerprint) [ $# -ge 2 ] || usage; required=$2; shift 2 ;;
    --keyring) [ $# -ge 2 ] || usage; keyring=$2; shift 2 ;;
    -*) usage ;;
    *) break ;;
  esac
done
if [ -n "$required" ] && [ -n "$keyring" ]; then usage; fi
if [ -z "$required" ] && [ -z "$keyring" ]; then
  fail "the laboratory's key is not given, so that the folder cannot be verified." \
    "Give the fingerprint of the key as the laboratory published it, not as a file of this folder says it:" \
    "  sudo sh $0 --fingerprint 'XXXX XXXX ...'"
fi
if [ -n "$required" ]; then
  given=$required
  required=$(printf '%s' "$required" | tr -d ' :\t\n' | sed 's/^0[xX]//' | tr 'a-f' 'A-F')
  case $required in *[!0-9A-F]*) fail "the fingerprint '$given' has characters other than 0 to 9 and A to F." ;; esac
  case ${#required} in
    40|64) ;;
    *) fail "the fingerprint '$given' has ${#required} digits; required: all of them, 40 (or 64)." ;;
  esac
  keyring=$source/laboratory-key.gpg
fi
[ -r "$keyring" ] || fail "the key $keyring cannot be read."
if [ $check_only = no ] && [ "$(id -u)" -ne 0 ]; then
  fail "installing needs root: sudo sh $0 ..." "Without root, --check verifies the folder."
fi

# All that follows uses a copy: a folder on a stick could change between the check and the installation.
work=$(mktemp -d "${TMPDIR:-/var/tmp}/abcal-install.XXXXXX")
trap 'rm -rf "$work"' EXIT
trap 'exit 1' HUP INT TERM
mkdir "$work/copy"
for file in SHA256SUMS SHA256SUMS.sign; do
  cp "$source/$file" "$work/copy/$file" 2>/dev/null || fail "$source/$file is missing or cannot be read: the folder is unsigned or incomplete."
done
cp "$keyring" "$work/key.gpg"

# --- The signature, by the tool that apt itself uses: gpgv on Debian 12, sqv on Debian 13 ---------------------------------
cd "$work/copy"
signer=
if command -v gpgv >/dev/null; then
  if gpgv --status-fd 1 --keyring "$work/key.gpg" SHA256SUMS.sign SHA256SUMS >"$work/status" 2>"$work/said"; then
    signer=$(awk '$2 == "VALIDSIG" { print $NF; exit }' "$work/status")
  fi
elif command -v sqv >/dev/null; then
  if sqv --keyring "$work/key.gpg" --signature-file SHA256SUMS.sign SHA256SUMS >"$work/status" 2>"$work/said"; then
    signer=$(head -n 1 "$work/status")
  fi
else
  fail "neither gpgv nor sqv is installed; one of them belongs to every Debian with apt."
fi
if [ -z "$signer" ]; then
  cat "$work/said" >&2
  fail "SHA256SUMS does not have a valid signature by the key in $keyring: it was changed after it was signed, or signed by another key." \
    "This computer's date is $(date +%Y-%m-%d); if it is wrong, set it and try again."
fi
if [ -n "$required" ] && [ "$signer" != "$required" ]; then
  fail "the folder is signed by another key." "found:    $signer" "required: $required"
fi

# --- Each file against the signed list -----------------------------------------------------------------------------------
mkdir packages
sed 's/^[0-9a-f]* [ *]//' SHA256SUMS >"$work/files"
while IFS= read -r file; do
  cp "$source/$file" "$file" 2>/dev/null || true
done <"$work/files"
if ! sha256sum --check --strict SHA256SUMS >"$work/checked" 2>"$work/said"; then
  bad=$(sed -n 's/: FAILED open or read$/ (missing)/p; s/: FAILED$/ (changed)/p' "$work/checked" | tr '\n' ' ')
  fail "these files are not those that the laboratory signed: ${bad:-$(cat "$work/said")}" "Copy the folder again, or ask the laboratory for another copy."
fi
count=$(wc -l <"$work/files")
echo "Signed by $signer; all $count files are those that were signed."

# --- The computer ----------------------------------------------------------------------------------------------------------
content() { sed -n "s/^$1: //p" contents.txt; }
ID='' VERSION_ID='' PRETTY_NAME=''
. /etc/os-release
if [ $check_only = yes ]; then
  echo "The folder installs abcal $(content Version) on Debian $(content Debian) ($(content Codename)), $(content Architecture). Nothing was installed."
  exit 0
fi
if [ "$ID" != debian ] || [ "$VERSION_ID" != "$(content Debian)" ]; then
  fail "this folder is for Debian $(content Debian) ($(content Codename)); this computer has ${PRETTY_NAME:-another system}." \
    "Use the folder that was made for it: scripts/package --with-dependencies makes one for Debian 12 or 13."
fi
if [ "$(dpkg --print-architecture)" != "$(content Architecture)" ]; then
  fail "this folder is for $(content Architecture); this computer is $(dpkg --print-architecture)."
fi

# --- Installation: apt with this copy as its only source ---------------------------------------------------------------------
mkdir -p "$work/lists/partial" "$work/cache/archives/partial"
echo "deb [trusted=yes] file:$work/copy ./" >"$work/sources.list"  # verified above
quiet_apt() {
  apt-get -q -o Dir::Etc::SourceList="$work/sources.list" -o Dir::Etc::SourceParts=/dev/null -o Dir::Etc::Preferences=/dev/null \
    -o Dir::Etc::PreferencesParts=/dev/null -o Dir::State::Lists="$work/lists" -o Dir::Cache="$work/cache" -o APT::Default-Release= \
    -o APT::Sandbox::User=root -o APT::Install-Recommends=false -o Acquire::Languages=none "$@"
}
chmod -R go+rX "$work"
log=/var/log/abcal-install.log
# The packages that contents.txt lists, and those of the command line.
# shellcheck disable=SC2046
set -- $(content Install) "$@"
echo "Installing abcal $(content Version); the log is $log"
if ! { quiet_apt update && DEBIAN_FRONTEND=noninteractive quiet_apt install --yes --no-remove -o Dpkg::Options::=--force-confdef \
  -o Dpkg::Options::=--force-confold "$@"; } >"$log" 2>&1; then
  tail -n 20 "$log" >&2
  echo "install: apt could not install the packages, for the reason above (all of it: $log)." >&2
  echo "  If packages of this computer are in the way or newer than those of the folder, ask for a folder that was made anew." >&2
  exit 1
fi
found=$(dpkg-query -W -f='${Version}' abcal)
if [ "$found" != "$(content Version)" ]; then
  echo "This computer already had the newer version $found, which stays."
fi
echo "Installed: $(abcal --version | head -n 1)"
echo "Next: abcal demo    calibrates an emulated bench in about a minute"
