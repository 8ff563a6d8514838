// The language of the page: the browser's, or the one chosen with the switch. English stands in the sources; the words of each
// other language are a table by the English ones, "{}" where a value stands.
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

// t`${n} of ${all} runs`, or t('Idle'): in the language of the page; in English if it has no words for it.
export function t(text, ...values) {
  const parts = typeof text === 'string' ? [text] : text;
  const said = words[parts.join('{}')];
  if (said === undefined) return parts.reduce((before, part, i) => before + values[i - 1] + part);
  let i = 0;
  return said.replace(/\{\}/g, () => values[i++]);
}

// What the program says in English, with the parts that are always the same in the language of the page.
export const rolesIn = (list) => list.split(', ').map((role) => t(role)).join(', ');
export const operatorIn = (words) => (words ?? '').replace(/\(stated, not verified\)$/, (stated) => t(stated));
export const angleIn = (words) => words.replace(/^experiment (\d), (\S+) degrees/, (_, experiment, angle) => t`experiment ${experiment}, ${angle} degrees`)
  .replace(/^check pose (\d+)/, (_, n) => t`check pose ${n}`).replace(' (closing angle)', (closing) => t(closing));

// All that the page has from the beginning.
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

// The switch: names the other language, in that language. Without an answer of the console the page is not left: what the browser
// would show instead does not come back by itself.
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
