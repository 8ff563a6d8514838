// The certificate of a run: what was issued, and the approval. Whoever approves proves it with a password, here and now.
import {element, DASH} from '/text.js';

const TEXT = {
  title: 'Certificate', none: 'No certificate has been issued for this run.', reading: 'Reading',
  issued: 'issued', approvedBy: 'approved by', replaces: 'replaces', measuredBy: 'Measured by', fourEyes: 'Whoever measured cannot approve.',
  approver: 'Approved by (a person who may approve)', password: 'Password of this person', reason: 'Why the certificate is amended',
  seen: 'I have looked at the result, its checks and its pictures, and approve it.', approve: 'Approve and issue', amend: 'Approve and replace it',
  busy: 'The certificate is being made', done: 'Issued', training: 'TRAINING: it certifies nothing.', amended: 'Amend it',
};

const encoded = (name) => encodeURIComponent(name);
const line = (certificate) => `${certificate.number}, ${TEXT.issued} ${certificate.date}, ${TEXT.approvedBy} ${certificate.approved_by}`
  + (certificate.replaces ? `; ${TEXT.replaces} ${certificate.replaces}: ${certificate.reason}` : '');

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
    return body.replaceChildren(problem(String(error.message || error)));
  }
  const {certificates} = state;
  const list = certificates.length ? element('ul', {}, ...certificates.map((one) => element('li', {}, line(one)))) : element('p', {}, TEXT.none);
  if (state.why_not) return body.replaceChildren(list, element('p', {}, state.why_not));
  const form = approvalForm(run, state, changed);
  body.replaceChildren(list, ...(certificates.length ? [element('details', {}, element('summary', {}, TEXT.amended), form)] : [form]));
}

function approvalForm(run, state, changed) {
  const last = state.certificates.at(-1);
  const input = (id, attributes) => element('input', {id: `approve-${id}`, required: true, autocomplete: 'off', maxlength: 200, ...attributes});
  const labelled = (words, control) => element('div', {}, element('label', {for: control.id}, words), control);
  const approver = input('name'), password = input('password', {type: 'password'}), reason = input('reason'), seen = input('seen', {type: 'checkbox'});
  approver.value = state.measured_by.split(', ').includes(state.person) ? '' : state.person;
  const button = element('button', {class: 'go'}, last ? TEXT.amend : TEXT.approve), said = element('p', {id: 'approve-said', role: 'status'});
  const form = element('form', {id: 'approve-form'},
    element('p', {}, `${TEXT.measuredBy} ${state.measured_by || DASH}. ${TEXT.fourEyes}`),
    element('div', {class: 'pair'}, labelled(TEXT.approver, approver), labelled(TEXT.password, password), ...(last ? [labelled(TEXT.reason, reason)] : [])),
    element('label', {class: 'check'}, seen, element('span', {}, TEXT.seen)), button, said);
  form.addEventListener('submit', async (event) => {
    event.preventDefault();
    if (button.disabled) return;
    button.disabled = true;
    said.className = '';
    said.textContent = TEXT.busy;
    const fields = {run: run.name, run_sha256: state.run_sha256, name: approver.value, password: password.value};
    if (last) Object.assign(fields, {replaces: last.number, reason: reason.value});
    password.value = '';
    try {
      const response = await fetch('/approve', {method: 'POST', body: new URLSearchParams(fields)});
      if (!response.ok) throw new Error((await response.text()).trim());
      const issued = await response.json();
      said.textContent = `${TEXT.done}: ${issued.number}. ${issued.training ? TEXT.training : ''} ${issued.warnings.join(' ')}`;
      changed();
    } catch (error) {
      said.className = 'grade-problem';
      said.textContent = String(error.message || error);
      button.disabled = false;
    }
  });
  return form;
}
