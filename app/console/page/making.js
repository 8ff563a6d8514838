// Requests that take the console seconds: shown with a text and a button "Cancel", which also ends the work at the console.
import {element} from '/text.js';
import {fetched} from '/fetched.js';
import {said} from '/said.js';
import {t} from '/language.js';

const TEXT = {cancel: t('Cancel'), cancelled: t('Cancelled.'), printing: t('The PDF is being made.')};

let ofView = null;  // Aborts the request of the current view when another view is shown.

export function endMaking() {
  ofView?.abort();
  ofView = null;
}

// Resolves to read(response); null: the person has cancelled the request, or has gone to another view.
async function ask(path, holder, words, read, ends) {
  const cancel = element('button', {type: 'button', class: 'cancel'}, TEXT.cancel);
  cancel.addEventListener('click', () => { ends.abort(); holder.replaceChildren(element('p', {role: 'status'}, TEXT.cancelled)); });
  holder.replaceChildren(element('p', {role: 'status'}, words), cancel);
  try {
    const response = await fetched(path, {signal: ends.signal});
    if (!response.ok) throw new Error((await response.text()).trim() || t`the console answered ${response.status}`);
    return await read(response);
  } catch (error) {
    if (ends.signal.aborted) return null;
    throw error;
  }
}

// Resolves to the JSON for a view; one such request at a time.
export function askForView(path, holder, words) {
  endMaking();
  ofView = new AbortController();
  return ask(path, holder, words, (response) => response.json(), ofView);
}

// Makes a link wait for a product that takes seconds: shows the wait in `holder`, then saves the product.
export function savesPatiently(link, holder) {
  link.addEventListener('click', async (event) => {
    event.preventDefault();
    if (link.getAttribute('aria-disabled') === 'true') return;
    link.setAttribute('aria-disabled', 'true');
    try {
      const made = await ask(link.href, holder, TEXT.printing, (response) => response.blob(), new AbortController());
      if (!made) return;
      const saved = element('a', {href: URL.createObjectURL(made), download: link.download});
      saved.click();
      setTimeout(() => URL.revokeObjectURL(saved.href), 60_000);
      holder.replaceChildren();
    } catch (error) {
      holder.replaceChildren(element('p', {role: 'alert', class: 'grade-problem'}, said(error.message || error)));
    } finally {
      link.removeAttribute('aria-disabled');
    }
  });
  return link;
}
