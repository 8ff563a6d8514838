// The language of the page: the browser's, or the one chosen with the switch. The sources have the English text; each other
// language is a table by the English text, with "{}" for a value.
import de from '/de.js';

const TABLES = {de};
const KEY = 'abcal-language';
const NAMES = {en: 'English', de: 'Deutsch'};

function chosen() {
  const kept = localStorage.getItem(KEY);
  if (kept in NAMES) return kept;
  return navigator.languages.map((tag) => tag.split('-')[0]).find((language) => language in NAMES) ?? 'en';
}

export const language = chosen();
const words = TABLES[language] ?? {};

// t`${n} of ${all} runs`, or t('Idle'): the text in the language of the page; in English if the table has no entry.
export function t(text, ...values) {
  const parts = typeof text === 'string' ? [text] : text;
  const said = words[parts.join('{}')];
  if (said === undefined) return parts.reduce((before, part, i) => before + values[i - 1] + part);
  let i = 0;
  return said.replace(/\{\}/g, () => values[i++]);
}

// English texts of the program, with their constant parts in the language of the page.
export const rolesIn = (list) => list.split(', ').map((role) => t(role)).join(', ');
export const operatorIn = (words) => (words ?? '').replace(/\(stated, not verified\)$/, (stated) => t(stated));

// Translates the initial contents of the page.
export function translate(root = document.body) {
  document.documentElement.lang = language;
  if (!TABLES[language]) return;
  document.title = t(document.title);
  const walker = document.createTreeWalker(root, NodeFilter.SHOW_TEXT);
  while (walker.nextNode()) {
    const node = walker.currentNode, text = node.data.replace(/\s+/g, ' ').trim();
    if (text in words) node.data = node.data.replace(/\S[^]*\S|\S/, () => words[text]);
  }
  for (const name of ['aria-label', 'title', 'placeholder'])
    for (const element of root.querySelectorAll(`[${name}]`)) element.setAttribute(name, t(element.getAttribute(name)));
}

// The switch: names the other language, in that language. Without an answer of the console the page is not reloaded: the error
// page of the browser would not return to it by itself.
export function offerLanguage(button, unanswered = () => {}) {
  const other = language === 'de' ? 'en' : 'de';
  button.textContent = NAMES[other];
  button.lang = other;
  button.addEventListener('click', async () => {
    try {
      await fetch('/who');
    } catch {
      return unanswered();
    }
    localStorage.setItem(KEY, other);
    location.reload();
  });
}
