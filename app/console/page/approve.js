// The certificate of a run: what was issued, and the approval. Whoever approves proves it with a password, here and now.
import {element, DASH} from '/text.js';
import {said} from '/said.js';
import {t} from '/language.js';

const TEXT = {
  title: t('Certificate'), none: t('No certificate has been issued for this run.'), reading: t('Reading what was issued'),
  fourEyes: t('Whoever measured cannot approve.'),
  approver: t('Approved by (a person who may approve)'), password: t('Password of this person'), reason: t('Why the certificate is amended'),
  seen: t('I have looked at the result, its checks and its pictures, and approve it.'), approve: t('Approve and issue'), amend: t('Approve and replace it'),
  busy: t('The certificate is being made'), training: t('TRAINING: it certifies nothing.'), amended: t('Amend it'),
};

const encoded = (name) => encodeURIComponent(name);
const line = ({number, date, approved_by: approver, replaces, reason}) => t`${number}, issued ${date}, approved by ${approver}` + (replaces ? t`; replaces ${replaces}: ${reason}` : '');

// A card that fills itself; `changed` is called when a certificate was issued.
export function certificateCard(run, changed) {
  const body = element('div', {id: 'certificate'}, element('p', {role: 'status'}, TEXT.reading));
  fill(run, body, changed);
  return element('section', {class: 'card block', 'aria-labelledby': 'certificate-title'}, element('h3', {id: 'certificate-title'}, TEXT.title), body);
}

async function fill(run, body, changed) {
  const problem = (words) => element('p', {role: 'alert', class: 'grade-problem'}, words);
  let state;
  try {
    const response = await fetch(`/runs/${encoded(run.name)}/approval`);
    if (!response.ok) throw new Error((await response.text()).trim());
    state = await response.json();
  } catch (error) {
    return body.replaceChildren(problem(said(error.message || error)));
  }
  const {certificates} = state;
  const list = certificates.length ? element('ul', {}, ...certificates.map((one) => element('li', {}, line(one)))) : element('p', {}, TEXT.none);
  if (state.why_not) return body.replaceChildren(list, element('p', {}, said(state.why_not)));
  const form = approvalForm(run, state, changed);
  body.replaceChildren(list, ...(certificates.length ? [element('details', {}, element('summary', {}, TEXT.amended), form)] : [form]));
}

function approvalForm(run, state, changed) {
  const last = state.certificates.at(-1);
  const input = (id, attributes) => element('input', {id: `approve-${id}`, required: true, autocomplete: 'off', maxlength: 200, ...attributes});
  const labelled = (words, control) => element('div', {}, element('label', {for: control.id}, words), control);
  const approver = input('name'), password = input('password', {type: 'password'}), reason = input('reason'), seen = input('seen', {type: 'checkbox'});
  approver.value = state.measured_by.split(', ').includes(state.person) ? '' : state.person;
  const button = element('button', {class: 'go'}, last ? TEXT.amend : TEXT.approve), told = element('p', {id: 'approve-said', role: 'status'});
  const form = element('form', {id: 'approve-form', class: 'no-print'},
    element('p', {}, t`Measured by ${state.measured_by || DASH}. `, TEXT.fourEyes),
    element('div', {class: 'pair'}, labelled(TEXT.approver, approver), labelled(TEXT.password, password), ...(last ? [labelled(TEXT.reason, reason)] : [])),
    element('label', {class: 'check'}, seen, element('span', {}, TEXT.seen)), button, told);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (button.disabled) return;
    button.disabled = true;
    told.className = '';
    told.textContent = TEXT.busy;
    const fields = {run: run.name, run_sha256: state.run_sha256, name: approver.value, password: password.value};
    if (last) Object.assign(fields, {replaces: last.number, reason: reason.value});
    password.value = '';
    try {
      const response = await fetch('/approve', {method: 'POST', body: new URLSearchParams(fields)});
      if (!response.ok) throw new Error((await response.text()).trim());
      const issued = await response.json();
      told.replaceChildren(t`Issued: ${issued.number}. `, issued.training ? TEXT.training : '', ' ', said(issued.warnings.join(' ')));
      changed();
    } catch (error) {
      told.className = 'grade-problem';
      told.replaceChildren(said(error.message || error));
      button.disabled = false;
    }
  });
  return form;
}
