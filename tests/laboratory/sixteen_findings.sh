#!/usr/bin/env bash
# Shows by commands of the built program that each finding of an assessment is closed (docs/assessor.md).
#   sixteen_findings.sh ABCAL EXAMPLES     ABCAL: the program; EXAMPLES: docs/examples
# Prints for each finding its number, the command, what happened, and PASS or FAIL; ends with 1 if one fails.
set -uo pipefail
abcal=$(realpath "$1") examples=$(realpath "$2") look_at=$(realpath "$(dirname "$0")")/look_at.py
python=/usr/bin/python3 # The system's own: h5py is a package of the system's.
for tool in "$python" sqlite3 xmllint openssl weasyprint pdftotext pdffonts pdfinfo; do
  command -v "$tool" >/dev/null || { echo "$tool is not installed"; exit 77; }
done
"$python" -c 'import h5py' 2>/dev/null || { echo "python3-h5py is not installed"; exit 77; }
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cd "$work" || exit 1
export XDG_STATE_HOME=$work/state
unset ABCAL_REGISTER ABCAL_SIGNING_KEY ABCAL_TIME_STAMP_AUTHORITY
failed=0 found=0

# finding NUMBER TITLE
finding() { number=$1 found=$((found + 1)); printf '\nFinding %s: %s\n' "$1" "$2"; }
# expect EXIT WORDS COMMAND...: the command ends with EXIT and says WORDS (a basic regular expression).
expect() {
  local code=$1 words=$2 ended shown
  shift 2
  "$@" >said 2>&1
  ended=$?
  shown="$*"
  shown=${shown//$abcal/abcal} shown=${shown//$look_at/look_at.py}
  printf '  %s\n' "${shown//$python /}"
  if [ "$ended" -eq "$code" ] && grep -q -- "$words" said; then
    printf '    %s (exit code %s): PASS\n' "$(grep -m1 -- "$words" said | sed 's/^ *//' | cut -c1-180)" "$ended"
  else
    printf '    exit code %s; required: %s and "%s": FAIL\n' "$ended" "$code" "$words"
    head -c 1500 said | sed 's/^/      /'
    failed=1
  fi
}
must() { "$@" >said 2>&1 || { cat said; echo "preparation failed: $*"; exit 1; }; }
lab() { must "$abcal" lab "$@"; }
login() { lab login "$1" --password-file password; }
look() { expect 0 '.' "$python" "$look_at" "$@"; }
fonts_not_embedded() { pdffonts "$1" | tail -n +3 | grep -vc ' yes yes yes '; }
# path XPATH: with names of elements that hold in whatever namespace.
path() { sed -E 's/([/[])([a-zA-Z]+)/\1*[local-name()="\2"]/g' <<<"$1"; }
register() { # register FILE [--training]: with two persons who may measure and approve
  export ABCAL_REGISTER=$work/$1
  lab init --laboratory "Example laboratory" --administrator "Approver N. N." "${@:2}" --password-file password
  login "Approver N. N."
  lab add person "Operator N. N." --role technician --may measure --may approve --password-file password
}
measure() { # measure NAME SED...: the example with 12 angles and 50 readings, as changed, into NAME.run
  local name=$1
  shift
  sed -e 's/^steps = 72/steps = 12/' -e 's/^step_deg = 5.0$/step_deg = 30.0/' \
    -e 's/^dwell_readings = 1000/dwell_readings = 50/' "$@" "$examples/simulated.toml" >"$name.toml"
  must "$abcal" run "$name.toml" -o "$name.run"
}

printf 'correct horse 7\n' >password
chmod 600 password
cp "$examples/laboratory.toml" lab.toml
for k in 1 2 3 4 5 6 7; do measure $k -e "s/^seed = .*/&\nrun = $k/"; done # other runs on the same bench
measure off -e 's/^seed = .*/&\nrun = 8/' -e 's/^offset = \[0.0054/offset = [0.0104/'
measure joint -e 's/^\[protocol\].*/[protocol]\nestimator = "joint"/'
register training.db --training
login "Operator N. N."
measure own
login "Approver N. N."
must "$abcal" issue own.run --laboratory lab.toml --dcc own.xml --pdf own.pdf
must pdftotext -layout own.pdf own.txt
must pdftotext -bbox own.pdf own.boxes
"$abcal" report own.run --json >own.json

finding 1 "two uncertainties for one result"
look budget own.json

finding 2 "the operator approves his own run"
expect 1 'who measured by the events of the run' "$abcal" issue 1.run --laboratory lab.toml --measured-by "Third P."
login "Operator N. N."
measure mine
expect 1 'a person other than the one who measured' "$abcal" issue mine.run --laboratory lab.toml
login "Approver N. N."

register real.db
sed -e 's/serial_number = "118001234"/serial_number = "1"/' -e 's/quantity = "gravity"/quantity = "other"/' lab.toml \
  >untraced.toml
finding 3 "sizes of effects that nobody stated"
expect 1 'effects: found not stated, so default sizes are used' "$abcal" issue 1.run --laboratory lab.toml
expect 1 'effects: found stated without a source' "$abcal" issue 1.run --laboratory lab.toml

finding 4 "traceability that was not earned"
expect 1 'instruments: found simulated' "$abcal" issue 1.run --laboratory untraced.toml
expect 1 'gravity: found no calibrated equipment' "$abcal" issue 1.run --laboratory untraced.toml
expect 1 'local gravity: found source "Geist' "$abcal" issue 1.run --laboratory lab.toml
expect 1 'with quantity = "angle" and this serial_number' "$abcal" issue 1.run --laboratory untraced.toml
export ABCAL_REGISTER=$work/training.db

finding 5 "a typed-in temperature as an observation"
expect 0 'stated by the operator' xmllint --nonet --xpath "$(path '//influenceCondition[@refType="basic_temperature"]/name')" own.xml
expect 0 'stated by' grep 'Temperature of the room' own.txt

finding 6 "certificates removed, a number given twice"
cp own.run forged.run
cp own.run.results forged.run.results
chmod u+w forged.run.results
must sqlite3 forged.run.results 'delete from certificate'
expect 1 'certificate T-.*-0001' "$abcal" verify forged.run
must sqlite3 forged.run.results 'delete from analysis'
expect 1 'no analysis is stored of joint, abc, norm' "$abcal" verify forged.run
expect 0 'certificate T-.*-0002' "$abcal" issue 1.run --laboratory lab.toml
cp training.db tampered.db
must sqlite3 tampered.db "update certificate set run_sha256 = (select run_sha256 from certificate where number like '%-0001')"
expect 1 'certificate' env ABCAL_REGISTER=tampered.db "$abcal" lab verify

finding 7 "a mean of several results without type B"
expect 0 'Mean with type B' "$abcal" compare 3.run 5.run 7.run

finding 8 "limits that contain the fault"
lab add item --maker MicroStrain --model 3DM-GV7-AR --serial-number 6284.123456
lab chart approve CHECK 2.run 3.run 4.run 5.run 6.run
expect 0 'in control' "$abcal" lab chart add CHECK 7.run
expect 1 'OUTSIDE' "$abcal" lab chart add CHECK off.run
expect 1 'is blocked since' "$abcal" issue joint.run --laboratory lab.toml
lab chart lift CHECK --reason "offset of the item adjusted back"

finding 9 "dates that contradict each other or the clock"
expect 1 'date of issue: found 2199-01-01; required: not after today' "$abcal" issue 3.run --laboratory lab.toml --date 2199-01-01
expect 1 'required: not before the run' "$abcal" issue 3.run --laboratory lab.toml --date 1999-01-01

finding 10 "an uncertainty below the laboratory's capability"
lab add scope S-1 --quantity sensitivity --unit mg/g --from 500 --to 2000 --cmc 20
must "$abcal" issue 2.run --laboratory lab.toml --dcc scope.xml
expect 0 'U raised to the smallest of the laboratory' xmllint --nonet --xpath "$(path '(//metaData[@refType="abc_raisedToScope"]/name)[1]')" scope.xml

finding 11 "pages and XML that differ, a quality record for the customer"
look numbers own.xml own.txt
must pdftotext own.pdf all.txt
expect 0 'Annex' grep -m1 Annex all.txt
expect 0 'abc_budget' grep -o 'refType="abc_budget"' own.xml
expect 0 'covarianceMatrix' grep -o -m1 'covarianceMatrixXMLList' own.xml

finding 12 "an estimator chosen after the result is known"
expect 0 'certificate T-' "$abcal" issue joint.run --laboratory lab.toml --dcc joint.xml
expect 0 'joint' xmllint --nonet --xpath "$(path '//usedMethod[@refType="abc_estimator"]/name')" joint.xml
expect 2 'estimator' "$abcal" issue 4.run --laboratory lab.toml --estimator joint

finding 13 "digits, significantDigit, one refType a result"
look results own.xml

finding 14 "HDF5 that others misread"
must "$abcal" report own.run --record --hdf5 own.h5
look hdf5 own.h5

finding 15 "pages: white space, notation, fonts, tags"
look pages own.boxes own.txt
expect 0 'Tagged: *yes' pdfinfo own.pdf
expect 1 '^0$' fonts_not_embedded own.pdf

finding 16 "schemas that are not used"
expect 0 'schemas: .*: read' "$abcal" self-test
schemas=$(sed -n 's/.*schemas: \(.*\): read.*/\1/p' said)
expect 0 'validates' xmllint --nonet --noout --schema "$schemas/v3.3.0/dcc.xsd" own.xml
mkdir none
expect 2 'none' "$abcal" issue 5.run --laboratory lab.toml --schemas none

# A person who can write all files still has neither the key of the bench nor that of the authority.
number=evidence
printf '\nEvidence: a run that is signed and stamped, changed by someone who may write every file\n'
cat >tsa.cnf <<'C'
[tsa]
default_tsa = one
[one]
serial = ./serial
signer_cert = ./tsa.pem
certs = ./ca.pem
signer_key = ./tsa.key
signer_digest = sha256
default_policy = 1.2.3.4.1
digests = sha256
[ext]
extendedKeyUsage = critical,timeStamping
C
echo 01 >serial
ec=(-newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes)
must openssl req -x509 "${ec[@]}" -keyout ca.key -out ca.pem -days 30 -subj "/CN=Root of the test"
must openssl req "${ec[@]}" -keyout tsa.key -out tsa.csr -subj "/CN=Authority of the test"
must openssl x509 -req -in tsa.csr -CA ca.pem -CAkey ca.key -CAcreateserial -out tsa.pem -days 30 -extfile tsa.cnf -extensions ext
stamp() { # stamp RUN
  must "$abcal" lab timestamp "$1" --query "$1.tsq"
  must openssl ts -reply -config tsa.cnf -section one -queryfile "$1.tsq" -out "$1.tsr"
  must "$abcal" lab timestamp "$1" --query "$1.tsq" --answer "$1.tsr"
}
unset ABCAL_REGISTER
for who in bench thief; do
  must openssl genpkey -algorithm ed25519 -out $who.pem
  must openssl pkey -in $who.pem -pubout -out $who.pub
  chmod 600 $who.pem
done
both=(--require signed --require timestamped --key bench.pub --authority ca.pem)
ABCAL_SIGNING_KEY=$work/bench.pem measure sealed
stamp sealed.run
expect 0 'unchanged since' "$abcal" verify sealed.run "${both[@]}"
cp sealed.run.results sealed.kept
chmod u+w sealed.run
must sqlite3 sealed.run 'update reading set u = u * 1.0005; update dwell set r_u = r_u * 1.0005'
expect 1 'dwell 1 .* were changed' "$abcal" verify sealed.run "${both[@]}"
rm sealed.run.results
"$abcal" analyse sealed.run >said 2>&1
expect 1 'dwell 1 .* were changed' "$abcal" verify sealed.run "${both[@]}"
# Everything is made again with another key, and a stamp of the same authority.
rm -f sealed.run sealed.run.results
ABCAL_SIGNING_KEY=$work/thief.pem measure sealed -e 's/^offset = \[0.0054/offset = [0.0055/'
stamp sealed.run
expect 1 'was not signed by a trusted key' "$abcal" verify sealed.run "${both[@]}"

echo
[ "$found" -eq 16 ] || { echo "$found findings instead of 16"; failed=1; }
[ "$failed" -eq 0 ] && echo "All 16 findings are closed."
exit "$failed"
