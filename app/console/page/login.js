import {offerLanguage, t, translate} from '/language.js';

// The login: the form is posted once; from then on a cookie that no script can read identifies the visitor. A token after "#" in
// the address is never sent as a part of the address.
translate();
const refusal = document.getElementById('refusal');
const unanswered = () => { refusal.textContent = t('The console does not answer.'); };
offerLanguage(document.getElementById('language'), unanswered);

async function post(fields) {
  refusal.textContent = '';
  try {
    const response = await fetch('/login', {method: 'POST', body: new URLSearchParams(fields)});
    if (response.ok) return location.replace('/');
    refusal.textContent = (await response.text()).trim();
  } catch {
    unanswered();
  }
}

document.querySelector('form').addEventListener('submit', (event) => {
  event.preventDefault();
  post(new FormData(event.target));
});

const given = new URLSearchParams(location.hash.slice(1)).get('token');
if (given) {
  history.replaceState(null, '', '/');
  post({token: given});
}
