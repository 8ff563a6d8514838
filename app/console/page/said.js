// Translates English texts of the program into the language of the page, by the tables of the certificates and of the console
// with "{name}" or "{}" for a value. A text without an entry stays English, and is marked as such.
import {language} from '/language.js';

const table = language === 'de' ? {...await (await fetch('/certificate_de.json')).json(), ...(await import('/program_de.js')).default} : {};
const place = /\{\w*\}/g;
const templates = Object.entries(table).filter(([english]) => english.includes('{') && /[a-z]{2}/i.test(english.replace(place, '')))
  .map(([english, said]) => ({pattern: new RegExp(`^${english.replace(/[.*+?^$()|[\]\\]/g, '\\$&').replace(place, '(.+?)')}$`), said, names: english.match(place), isShort: english.startsWith('{') && english.replace(place, '').replace(/[^a-z]/gi, '').length < 10}))
  .sort((a, b) => b.pattern.source.length - a.pattern.source.length);  // The longest pattern first.
const known = new Map();

// Translates a value: a number, a name, or one or more sentences; null: an English text without an entry.
function valueSaid(value) {
  const whole = translated(value);
  if (whole !== null || !value.includes('; ')) return whole ?? (/[a-z]{3,} [a-z]{3,}/.test(value) ? null : value);
  const parts = value.split('; ').map(valueSaid);
  return parts.includes(null) ? null : parts.join('; ');
}

function byTemplate(words) {
  for (const {pattern, said, names, isShort} of templates) {
    const found = pattern.exec(words)?.slice(1);
    // "{effect} of {output}" is in many sentences that it did not make.
    if (!found || (isShort && found.some((value) => value.includes(' ') && !(value in table)))) continue;
    const values = found.map(valueSaid);
    if (values.includes(null)) continue;
    let i = 0;
    return said.replace(place, (name) => (name === '{}' ? values[i++] : values[names.indexOf(name)]));
  }
  return null;
}

// The translation of a text; null: there is none.
export function translated(words) {
  if (!known.has(words)) {
    known.set(words, null);  // Also during the search, which is recursive.
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

// An element with a text. Each of several joined sentences is translated if possible, else English.
export function said(words, {capital = false} = {}) {
  const written = (text) => (capital && text ? text[0].toUpperCase() + text.slice(1) : text);
  const holder = document.createElement('span'), all = language === 'en' ? null : translated(words);
  if (all !== null) {
    holder.append(written(all));
    return holder;
  }
  // "instrument: fault: detail; what to do": the parts have even indices, the separators odd ones.
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
