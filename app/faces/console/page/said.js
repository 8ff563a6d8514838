// What the program says in English, in the language of the page where it has words for it: by the table of the certificates and
// by that of the console, "{}" where a value stands. What has no words there stays English, and is marked so.
import {language} from '/language.js';

const load = async (name) => (await import(name)).default;
const table = language === 'de' ? {...await load('/certificate_de.js'), ...await load('/program_de.js')} : {};
const templates = Object.entries(table).filter(([english]) => english.includes('{}') && /[a-z]{2}/i.test(english))
  .map(([english, said]) => ({pattern: new RegExp(`^${english.replace(/[.*+?^$()|[\]\\]/g, '\\$&').replaceAll('{}', '(.+?)')}$`), said}))
  .sort((a, b) => b.pattern.source.length - a.pattern.source.length);  // The one that says most.
const known = new Map();

// A value is a number, a name, a sentence of its own or several; null: it is English.
function valueSaid(value) {
  const whole = translated(value);
  if (whole !== null || !value.includes('; ')) return whole ?? (/[a-z]{3,} [a-z]{3,}/.test(value) ? null : value);
  const parts = value.split('; ').map(valueSaid);
  return parts.includes(null) ? null : parts.join('; ');
}

function byTemplate(words) {
  for (const {pattern, said} of templates) {
    const values = pattern.exec(words)?.slice(1).map(valueSaid);
    if (!values || values.includes(null)) continue;
    let i = 0;
    return said.replace(/\{\}/g, () => values[i++]);
  }
  return null;
}

// Null: there are no words for it.
export function translated(words) {
  if (!known.has(words)) {
    known.set(words, null);  // Also while it is looked for.
    let said = table[words] ?? byTemplate(words);
    if (said === null && words.includes('; ')) {
      const parts = words.split('; ').map(translated);
      if (!parts.includes(null)) said = parts.join('; ');
    }
    if (known.size > 2000) known.clear();
    known.set(words, said);
  }
  return known.get(words);
}

// Of sentences that are joined, each in the language that there is.
export function said(words, {capital = false} = {}) {
  const written = (text) => (capital && text ? text[0].toUpperCase() + text.slice(1) : text);
  const holder = document.createElement('span'), all = language === 'en' ? null : translated(words);
  if (all !== null) {
    holder.append(written(all));
    return holder;
  }
  // "instrument: fault: detail; what to do": parts at even places, what stands between them at odd ones.
  const parts = language === 'en' ? [words] : words.split(/(; |: )/);
  const inEnglish = (text) => { const part = document.createElement('span'); part.lang = 'en'; part.append(text); return part; };
  const mixed = parts.map((part, i) => (i % 2 ? part : translated(part)));
  if (mixed.every((part, i) => i % 2 || part === null)) {
    holder.lang = 'en';
    holder.append(written(words));
  } else {
    parts.forEach((part, i) => holder.append(mixed[i] ?? (valueSaid(part) === part ? part : inEnglish(i ? part : written(part)))));
  }
  return holder;
}
