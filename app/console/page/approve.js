// The certificates of a run: those issued, and the approval. The approver is authenticated each time, by a password or by a key that
// stays in its place: the certificate is downloaded, signed where the key is, and handed in.
import {element, DASH} from '/text.js';
import {fetched} from '/fetched.js';
import {said} from '/said.js';
import {t} from '/language.js';

const TEXT = {
  title: t('Certificate'), none: t('No certificate has been issued for this run.'), noneOfItem: t('No certificate has been issued for this item.'), reading: t('Reading what was issued'),
  fourEyes: t('Whoever measured cannot approve.'),
  approver: t('Approved by (a person who may approve)'), password: t('Password of this person'), reason: t('Why the certificate is amended'),
  seen: t('I have looked at the result, its checks and its pictures, and approve it.'), approve: t('Approve and issue'), amend: t('Approve and replace it'),
  byKey: t('Approve with a key'), keys: t('Your keys in the register'), make: t('Make the certificate to be signed'), download: t('Download the certificate to be signed'),
  howToSign: t('Sign it where your private key is:'), signedFile: t('The signed certificate'), handIn: t('Issue with this signature'), checking: t('The signature is being checked'),
  noKey: t('With a key approves who is logged in, and the register has none of yours that is valid (abcal lab key NAME --kind person).'),
  amendment: t('Kind of amendment'), administrative: t('Administrative: no result and nothing of the item changes'), technical: t('Technical: every change is listed on the certificate'),
  changed: t('Changed statements:'),
  busy: t('The certificate is being made'), training: t('TRAINING: it certifies nothing.'), amended: t('Amend it'),
};

const UNANSWERED = 'no answer came: nobody knows whether it was carried out; load the page again and look before you repeat it';

const encoded = (name) => encodeURIComponent(name);
const statusOf = ({status, holds}) => status ? [' ', element('strong', {class: holds ? '' : 'grade-problem'}, said(status))] : [];
// The kind of an amendment: nothing is chosen beforehand.
const kindChoice = (id) => element('select', {id, required: true}, element('option', {value: ''}, DASH),
  element('option', {value: 'administrative'}, TEXT.administrative), element('option', {value: 'technical'}, TEXT.technical));
const line = ({number, date, approved_by: approver, replaces, reason}) => t`${number}, issued ${date}, approved by ${approver}` + (replaces ? t`; replaces ${replaces}: ${reason}` : '');

// The path at the console of an item of a run. item 0: the run has one item.
const pathOf = ({run, item}) => `/runs/${encoded(run.name)}${item ? `/items/${item}` : ''}`;
const namedIn = ({run, item}) => ({run: run.name, ...(item ? {item} : {})});

// A card that fills itself; `changed` is called when a certificate was issued. item: its number; 0: the run has one item.
export function certificateCard(run, item, changed) {
  const body = element('div', {id: 'certificate'}, element('p', {role: 'status'}, TEXT.reading));
  fill({run, item}, body, changed);
  return element('section', {class: 'card block', 'aria-labelledby': 'certificate-title'}, element('h3', {id: 'certificate-title'}, TEXT.title), body);
}

async function fill(of, body, changed) {
  const problem = (words) => element('p', {role: 'alert', class: 'grade-problem'}, words);
  let state;
  try {
    const response = await fetched(`${pathOf(of)}/approval`);
    if (!response.ok) throw new Error((await response.text()).trim());
    state = await response.json();
  } catch (error) {
    return body.replaceChildren(problem(said(error.message || error)));
  }
  const {certificates} = state;
  const list = certificates.length ? element('ul', {}, ...certificates.map((one) => element('li', {}, line(one), ...statusOf(one)))) : element('p', {}, of.item ? TEXT.noneOfItem : TEXT.none);
  if (state.why_not) return body.replaceChildren(list, element('p', {}, said(state.why_not)));
  const forms = [approvalForm(of, state, changed), keyForm(of, state, changed)];
  body.replaceChildren(list, ...(certificates.length ? [element('details', {}, element('summary', {}, TEXT.amended), ...forms)] : forms));
}

const labelled = (words, control) => element('div', {}, element('label', {for: control.id}, words), control);

// Sends a form and returns the answer of the console as JSON. On a refusal returns null, and shows the reason below the form.
async function ask(told, words, path, body) {
  told.className = '';
  told.textContent = words;
  try {
    const response = await fetched(path, {method: 'POST', body}, UNANSWERED);
    if (!response.ok) throw new Error((await response.text()).trim());
    return await response.json();
  } catch (error) {
    told.className = 'grade-problem';
    told.replaceChildren(said(error.message || error));
    return null;
  }
}

function tellIssued(told, issued, changed) {
  told.replaceChildren(t`Issued: ${issued.number}. `, issued.training ? TEXT.training : '', ...issued.warnings.flatMap((warning) => [' ', said(warning)]),
    ...(issued.changed?.length ? [element('p', {}, TEXT.changed), element('ul', {}, ...issued.changed.map((one) => element('li', {}, one)))] : []));
  changed();
}

// The form for approval by key: first the certificate is made and downloaded, then it is handed in with its signature.
function keyForm(of, state, changed) {
  const box = element('details', {id: 'approve-by-key', class: 'no-print'}, element('summary', {}, TEXT.byKey));
  if (!state.keys.length) {
    box.append(element('p', {}, TEXT.noKey));
    return box;
  }
  const last = state.certificates.at(-1);
  const seen = element('input', {id: 'key-seen', type: 'checkbox', required: true});
  const reason = element('input', {id: 'key-reason', required: true, autocomplete: 'off', maxlength: 200}), kind = kindChoice('key-amendment');
  const make = element('button', {}, TEXT.make), told = element('p', {id: 'key-said', role: 'status'}), second = element('div', {});
  const form = element('form', {id: 'key-form'},
    element('p', {}, `${TEXT.keys} (${state.person}):`), element('ul', {}, ...state.keys.map((key) => element('li', {}, element('code', {}, key.fingerprint)))),
    ...(last ? [labelled(TEXT.reason, reason), labelled(TEXT.amendment, kind)] : []), element('label', {class: 'check'}, seen, element('span', {}, TEXT.seen)), make);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (make.disabled) return;
    make.disabled = true;
    const made = await ask(told, TEXT.busy, '/approve', new URLSearchParams({...namedIn(of), run_sha256: state.run_sha256, by_key: 'yes',
      ...(last ? {replaces: last.number, reason: reason.value, amendment: kind.value} : {})}));
    make.disabled = false;
    if (!made) return;
    told.textContent = t`${made.number} waits for your signature.`;
    second.replaceChildren(handInForm(of, made, told, changed));
  });
  box.append(form, second, told);
  return box;
}

function handInForm(of, made, told, changed) {
  const file = `${made.number}.xml`, signed = `${made.number}-signed.xml`;
  const link = element('a', {id: 'key-download', download: file, href: URL.createObjectURL(new Blob([made.xml], {type: 'application/xml'}))}, TEXT.download);
  const chosen = element('input', {id: 'key-file', type: 'file', accept: '.xml', required: true}), button = element('button', {class: 'go'}, TEXT.handIn);
  const form = element('form', {id: 'hand-in-form'}, element('p', {}, link), element('p', {}, TEXT.howToSign),
    element('pre', {}, element('code', {}, `abcal lab sign ${file} --sign KEY.pem --certificate CERT.crt -o ${signed}`)),
    labelled(TEXT.signedFile, chosen), button);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (button.disabled || !chosen.files.length) return;
    button.disabled = true;
    const issued = await ask(told, TEXT.checking, `${pathOf(of)}/signed-certificate`, chosen.files[0]);
    if (issued) tellIssued(told, issued, changed);
    else button.disabled = false;
  });
  return form;
}

function approvalForm(of, state, changed) {
  const last = state.certificates.at(-1);
  const input = (id, attributes) => element('input', {id: `approve-${id}`, required: true, autocomplete: 'off', maxlength: 200, ...attributes});
  const approver = input('name'), password = input('password', {type: 'password'}), reason = input('reason'), seen = input('seen', {type: 'checkbox'}), kind = kindChoice('approve-amendment');
  approver.value = state.measured_by.split(', ').includes(state.person) ? '' : state.person;
  const button = element('button', {class: 'go'}, last ? TEXT.amend : TEXT.approve), told = element('p', {id: 'approve-said', role: 'status'});
  const form = element('form', {id: 'approve-form', class: 'no-print'},
    element('p', {}, t`Measured by ${state.measured_by || DASH}. `, TEXT.fourEyes),
    element('div', {class: 'pair'}, labelled(TEXT.approver, approver), labelled(TEXT.password, password), ...(last ? [labelled(TEXT.reason, reason), labelled(TEXT.amendment, kind)] : [])),
    element('label', {class: 'check'}, seen, element('span', {}, TEXT.seen)), button, told);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (button.disabled) return;
    button.disabled = true;
    const fields = {...namedIn(of), run_sha256: state.run_sha256, name: approver.value, password: password.value};
    if (last) Object.assign(fields, {replaces: last.number, reason: reason.value, amendment: kind.value});
    password.value = '';
    const issued = await ask(told, TEXT.busy, '/approve', new URLSearchParams(fields));
    if (issued) tellIssued(told, issued, changed);
    else button.disabled = false;
  });
  return form;
}
