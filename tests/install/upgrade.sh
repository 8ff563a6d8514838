#!/usr/bin/env bash
# Upgrades packages of an older version on this fresh system, checks what must stay unchanged, and removes them.
#   upgrade.sh FOLDER      with FOLDER/old/*.deb and FOLDER/new/*.deb
set -euo pipefail
folder=${1:?}
export DEBIAN_FRONTEND=noninteractive
fail() { echo "$*" >&2; exit 1; }
apt() { apt-get -y -qq --no-install-recommends "$@" >/tmp/apt.log 2>&1 || { tail -n 30 /tmp/apt.log >&2; fail "apt-get $* failed"; }; }
version() { dpkg-query -W -f='${db:Status-Abbrev}${Version}' "$1"; }

apt-get update -qq
apt install "$folder"/old/*.deb
old=$(version abcal)
# Files of a user: a bench file, a service that starts with the system, a run.
mkdir -p /etc/abcal /etc/systemd/system/multi-user.target.wants
cp /usr/share/doc/abcal/examples/simulated.toml /etc/abcal/bench.toml
service=/etc/systemd/system/multi-user.target.wants/abcal-console.service
ln -s /lib/systemd/system/abcal-console.service $service
mkdir -p /var/lib/abcal
abcal run /etc/abcal/bench.toml -o /var/lib/abcal/old.run >/tmp/run.log 2>&1 || { tail -n 20 /tmp/run.log >&2; exit 1; }
kept() { (cat /etc/abcal/bench.toml /var/lib/abcal/old.run && readlink $service && getent passwd abcal) | sha256sum; }
before=$(kept)

# Installs the dependencies first, so that dpkg alone upgrades.
apt install "$folder"/new/*.deb --download-only
names=$(for package in "$folder"/new/*.deb; do dpkg-deb -f "$package" Package; done)
apt-get install -s -qq --no-install-recommends "$folder"/new/*.deb >/tmp/plan
grep -vxFf <(echo "$names") <(awk '$1 == "Inst" { print $2 }' /tmp/plan) >/tmp/dependencies || true
xargs -r apt-get install -y -qq --no-install-recommends </tmp/dependencies >/tmp/apt.log 2>&1 || { tail /tmp/apt.log >&2; exit 1; }
dpkg -i "$folder"/new/*.deb >/tmp/dpkg.log 2>&1 || { cat /tmp/dpkg.log >&2; fail "dpkg -i of the new packages over the old ones failed"; }

[ -z "$(dpkg --audit)" ] || fail "dpkg --audit: $(dpkg --audit)"
for name in $names; do
  case $(version "$name") in "ii "*) ;; *) fail "$name: $(version "$name"), required: ii" ;; esac
done
[ "$(version abcal)" != "$old" ] || fail "abcal is still $old"
[ "$(kept)" = "$before" ] || fail "the bench file, the run, the service's link or the user changed"
[ "$(dpkg -S /usr/share/doc/abcal/examples/simulated.toml)" = "abcal-doc: /usr/share/doc/abcal/examples/simulated.toml" ] ||
  fail "examples belong to $(dpkg -S /usr/share/doc/abcal/examples/simulated.toml)"
# No file of the old packages is left without an owner.
for package in "$folder"/old/*.deb; do
  dpkg-deb --fsys-tarfile "$package" | tar -t | sed 's,^\.,,' | grep -v '/$' >/tmp/files
  while read -r file; do
    if [ -e "$file" ] && ! dpkg -S "$file" >/dev/null 2>&1; then fail "$file is left of the old package"; fi
  done </tmp/files
done
# The run of the old program is read by the new one.
abcal verify /var/lib/abcal/old.run >/tmp/verify || { cat /tmp/verify >&2; fail "the new program cannot verify the old run"; }
abcal analyse /var/lib/abcal/old.run >/dev/null
abcal plan /etc/abcal/bench.toml >/dev/null
# shellcheck disable=SC2086
apt purge $names
[ "$(cat /etc/abcal/bench.toml /var/lib/abcal/old.run | wc -c)" -gt 0 ] || fail "purging removed the run or the bench file"
echo "$old became $(dpkg-deb -f "$(ls "$folder"/new/abcal_*.deb)" Version); the bench file, its service, the user and the run stayed."
