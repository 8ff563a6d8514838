#!/usr/bin/env bash
# The signed folder for computers without a network, made of packages without contents from an archive without Debian: what is in
# it, what its script accepts and what it refuses. Needs neither root nor a network and installs nothing
# (offline_folder.sh does, in a fresh root).
#   offline_folder_of_dummies.sh SOURCE
set -euo pipefail
source=$1
for tool in gpg gpgconf dpkg-deb dpkg-scanpackages apt-get; do command -v $tool >/dev/null || { echo "no $tool"; exit 77; }; done
work=$(mktemp -d)
export GNUPGHOME=$work/gpg
trap 'gpgconf --kill all; rm -rf "$work"' EXIT
fail() { echo "$*" >&2; exit 1; }

# package FOLDER NAME VERSION ARCHITECTURE [FIELD...]
package() {
  local tree=$work/tree
  mkdir -p "$tree/DEBIAN" "$1"
  printf '%s\n' "Package: $2" "Version: $3" "Architecture: $4" "Maintainer: Laboratory <mail@example.org>" "Description: nothing" \
    "${@:5}" >"$tree/DEBIAN/control"
  dpkg-deb --build "$tree" "$1/$2_$3_$4.deb" >/dev/null
  rm -r "$tree"
}
archive=$work/archive
package "$archive" apt 1 amd64 "Depends: of-apt"
package "$archive" of-apt 1 amd64
package "$archive" required 1 amd64 "Priority: required"
package "$archive" required-tied 1 amd64 "Priority: required"
package "$archive" needed 2.0-1+deb13u1 amd64 "Depends: needed-by-needed, required, required-tied (= 1)"
package "$archive" needed-by-needed 1 all "Recommends: unneeded"
package "$archive" second-choice 1 amd64
package "$archive" unneeded 1 amd64
(cd "$archive" && dpkg-scanpackages . >Packages 2>/dev/null)
echo "deb [trusted=yes] file:$archive ./" >"$work/sources"
built=$work/built
package "$built" abcal 1.2-1 amd64 "Depends: needed (>= 2), of-apt" "Recommends: abcal-doc (= 1.2-1), first-choice | second-choice"
package "$built" abcal-doc 1.2-1 all
package "$built" libabcal-dev 1.2-1 amd64 "Depends: abcal (= 1.2-1)"

mkdir -m 700 "$GNUPGHOME"
key() { gpg --batch --quiet --passphrase '' --quick-generate-key "$1" ed25519 sign 1y 2>/dev/null; }
key laboratory@example.org
key stranger@example.org
fingerprint_of() { gpg --batch --with-colons --list-keys "$1" 2>/dev/null | awk -F: '$1 == "fpr" { print $10; exit }'; }
fingerprint=$(fingerprint_of laboratory@example.org)
make_folder() { "$source/scripts/offline-folder" --release trixie --packages "$built" --sources "$work/sources" --output "$work/folder" "$@"; }

# refused WORDS COMMAND...
refused() {
  local words=$1
  shift
  if "$@" >"$work/log" 2>&1; then fail "not refused: $*"; fi
  grep -qF -- "$words" "$work/log" || { cat "$work/log" >&2; fail "refused without the words \"$words\": $*"; }
}
refused "an unsigned folder is not made" make_folder
refused "gpg has no secret key nobody@example.org" make_folder --key nobody@example.org
refused "names several secret keys" make_folder --key example.org
[ ! -e "$work/folder" ] || fail "a folder was made without a key"
make_folder --key laboratory@example.org >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "no folder was made"; }
grep -qF "$fingerprint" "$work/log" || fail "the fingerprint is not printed"
grep -qx 'Install: abcal abcal-doc second-choice' "$work/folder/contents.txt" || fail "$(cat "$work/folder/contents.txt")"
found=$(cd "$work/folder/packages" && ls)
required=$(printf '%s\n' abcal_1.2-1_amd64.deb abcal-doc_1.2-1_all.deb libabcal-dev_1.2-1_amd64.deb needed_2.0-1+deb13u1_amd64.deb \
  needed-by-needed_1_all.deb required-tied_1_amd64.deb second-choice_1_amd64.deb | LC_ALL=C sort)
[ "$(LC_ALL=C sort <<<"$found")" = "$required" ] || fail "the folder holds"$'\n'"$found"$'\n'"required:"$'\n'"$required"

check() { sh "$work/folder/install" --check "$@"; }
spaced=$(printf '%s' "$fingerprint" | tr A-F a-f | sed 's/..../& /g')
check --fingerprint "$spaced" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "the unchanged folder is refused"; }
gpg --batch --export laboratory@example.org >"$work/key"
gpg --batch --export stranger@example.org >"$work/strange-key"
check --keyring "$work/key" >"$work/log" 2>&1 || { cat "$work/log" >&2; fail "the unchanged folder is refused with the key as a file"; }
refused "is not given" check
refused "has 16 digits" check --fingerprint "${fingerprint: -16}"
refused "signed by another key" check --fingerprint "$(fingerprint_of stranger@example.org)"
refused "does not have a valid signature" check --keyring "$work/strange-key"

# changed FILE CHANGE WORDS: refused after CHANGE, a command with the file as its last argument.
cp -a "$work/folder" "$work/good"
changed() {
  local file=$1 words=$2
  shift 2
  "$@" "$work/folder/$file"
  refused "$words" check --fingerprint "$fingerprint"
  rm -r "$work/folder"
  cp -a "$work/good" "$work/folder"
}
one_byte() { printf 'x' | dd of="$1" bs=1 seek=100 conv=notrunc status=none; }
changed packages/needed-by-needed_1_all.deb "packages/needed-by-needed_1_all.deb (changed)" one_byte
changed packages/needed-by-needed_1_all.deb "packages/needed-by-needed_1_all.deb (missing)" rm
changed install "install (changed)" sed -i '$a # more'
changed Packages "Packages (changed)" truncate -s 0
changed contents.txt "contents.txt (changed)" sed -i s/13/12/
changed SHA256SUMS "does not have a valid signature" sed -i 1d
changed SHA256SUMS.sign "unsigned or incomplete" rm
# Everything signed again by a stranger, with the stranger's key in the place of the laboratory's.
cp "$work/strange-key" "$work/folder/laboratory-key.gpg"
(cd "$work/folder" && find . -type f ! -name 'SHA256SUMS*' -printf '%P\n' | xargs sha256sum >SHA256SUMS)
gpg --batch --yes --local-user stranger@example.org --detach-sign --output "$work/folder/SHA256SUMS.sign" "$work/folder/SHA256SUMS" 2>/dev/null
refused "required: $fingerprint" check --fingerprint "$fingerprint"
